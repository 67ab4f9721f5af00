"""Where the results of a document come from."""

from __future__ import annotations

from crosscheck.document.part import Part


class Machine(Part, frozen=True, kw_only=True):
    """The machine a run was made on."""

    system: str
    processor: str
    cores: int | None


class Calibration(Part, frozen=True, kw_only=True):
    """The fixed work that speeds are compared with."""

    what: str
    us: float | None  # median
    deviation: float | None = None  # us, median absolute deviation


class Origin(Part, frozen=True, kw_only=True):
    """What figures were made with, as `crosscheck.running.provenance.describe` tells it."""

    time: str  # UTC
    engines: dict[str, str]  # name to version
    packages: dict[str, str]
    python: str
    machine: Machine
    commit: str | None


class Asked(Part, frozen=True, kw_only=True, omit_defaults=True):
    """What main runs take in place of what the plan says; None: as planned."""

    coordinate_map: str | None = None  # also of the order studies, with the engines that have this option
    step: float | None = None  # s, of methods with a fixed step
    duration: float | None = None  # s

    @property
    def words(self) -> list[str]:
        """The options of a command that asks for it."""
        given = (("--map", self.coordinate_map), ("--step", self.step), ("--duration", self.duration))
        return [word for option, value in given if value is not None for word in (option, str(value))]


AS_PLANNED = Asked()


class Meta(Origin, frozen=True, kw_only=True):
    """Where the results of `crosscheck verify` come from."""

    profile: str
    jobs: int
    command: str
    seconds: float  # of the whole run
    calibration: Calibration | None = None
    started: str | None = None  # UTC, ISO 8601; of a nightly run
    compared_with: str | None = None  # name of the run that `changes` are about
    asked: Asked = AS_PLANNED
