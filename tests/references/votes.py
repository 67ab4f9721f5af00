"""The formulation that the vote accuses."""

from crosscheck.references import TruthError, compute


def accused(scene):
    """The formulation that two others outvote on a scene, in the words of the truth or of its refusal."""
    try:
        return compute(scene).outvoted
    except TruthError as error:
        return str(error)
