"""What the results of a document were made with."""

from __future__ import annotations

from crosscheck.document.part import Part


class Machine(Part, frozen=True, kw_only=True):
    """The machine that a run was made on."""

    system: str
    processor: str
    cores: int | None


class Calibration(Part, frozen=True, kw_only=True):
    """A fixed piece of work. The times of runs are compared with its time."""

    what: str
    us: float | None  # median
    deviation: float | None = None  # us, median absolute deviation


class Origin(Part, frozen=True, kw_only=True):
    """What results were made with, from `crosscheck.running.provenance.describe`."""

    time: str  # UTC
    engines: dict[str, str]  # name to version
    packages: dict[str, str]
    python: str
    machine: Machine
    commit: str | None


class Asked(Part, frozen=True, kw_only=True, omit_defaults=True):
    """Options that the user asked for in main runs instead of those of the plan; None: as planned."""

    coordinate_map: str | None = None  # also in order studies, of the engines that have this option
    step: float | None = None  # s, of methods with a fixed step
    duration: float | None = None  # s

    @property
    def words(self) -> list[str]:
        """The command-line options that ask for the same."""
        given = (("--map", self.coordinate_map), ("--step", self.step), ("--duration", self.duration))
        return [word for option, value in given if value is not None for word in (option, str(value))]


AS_PLANNED = Asked()


class Meta(Origin, frozen=True, kw_only=True):
    """What the results of `crosscheck verify` were made with."""

    profile: str
    jobs: int
    command: str
    seconds: float  # of the whole run
    calibration: Calibration | None = None
    started: str | None = None  # UTC, ISO 8601; only of a nightly run
    compared_with: str | None = None  # name of the earlier run that `changes` compare with
    asked: Asked = AS_PLANNED
    reused: int = 0  # number of results that were computed by earlier commands
    reused_since: str | None = None  # UTC, when the oldest of them was computed
