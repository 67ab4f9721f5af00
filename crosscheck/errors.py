"""The errors a user of crosscheck can meet; nothing else is meant to reach him.

Two more live where they arise: `crosscheck.TruthError` (the two formulations of a scene's truth disagree, see
`crosscheck.references.base`) and `lieeuler.IntegrationError`, which carries the trajectory so far.
"""


class SceneError(Exception):
    """A scene file is wrong. The message names the file, the entry and the mend."""


class Unsupported(Exception):
    """An engine cannot model this scene, or not in this form or with this method; the message is the reason."""


class EngineError(Exception):
    """An engine failed while it ran; the message carries what it said."""


class ArgumentError(ValueError):
    """A wrong argument to a public function; the message names it and lists what is allowed."""
