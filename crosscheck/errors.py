"""The errors a user of crosscheck can meet; nothing else is meant to reach him."""


class SceneError(Exception):
    """A scene file is wrong. The message names the file, the entry and the mend."""


class Unsupported(Exception):
    """An engine cannot model this scene, or not in this form or with this method; the message is the reason."""


class EngineError(Exception):
    """An engine failed while it ran; the message carries what it said."""


class ArgumentError(ValueError):
    """A wrong argument to a public function; the message names it and lists what is allowed."""
