"""The answer of `explain`: causes, the evidence for each hypothesis that was tested, and one outcome."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from crosscheck.diagnosis.observe import Silent
from crosscheck.document.outcomes import EXIT_CODES, Outcome, code
from crosscheck.scene.alterations import FAILS


@dataclasses.dataclass
class Evidence:
    """One hypothesis that was tested."""

    hypothesis: str
    kind: str  # "start", "report", "model", "constraint", "numerics"
    before: float | None  # residual without it, in the unit of `quantity`
    after: float | None  # residual with it
    quantity: str  # name of the residual, with its unit
    magnitude: str = ""  # fitted magnitude, with its unit
    holds: bool = False  # whether the hypothesis explains the difference
    note: str = ""


@dataclasses.dataclass
class NamedCause:
    """A cause that explains a difference down to the noise, alone or together with the others named."""

    name: str
    magnitude: str
    mend: str

    def __str__(self) -> str:
        return f"{self.name} ({self.magnitude})"


@dataclasses.dataclass
class Explanation:
    """The answer of `crosscheck.diagnosis.explain`."""

    scene: str
    engine: str
    method: str
    form: str | None
    outcome: Outcome  # "pass": no difference; "fail": causes are named; "unresolved": it differs, the cause is unknown
    sentence: str
    causes: list[NamedCause]
    candidates: list[str]  # where more than one explanation fits equally well
    evidence: list[Evidence]
    window: float  # s, of the scene's motion that was looked at
    deviation: float | None  # of the engine's limit from truth, largest of |dx| / L, |dR|, |dv| / (L W), |dw| / W
    noise: float | None  # what the limit and truth leave open, same unit
    explained: float | None = None  # what is left of the deviation when the model is altered as named
    documented_order: int | None = None
    observed_order: float | None = None
    verdict: str = ""  # what `crosscheck verify` says of it, where nothing else was found
    tried: int = 0
    seconds: float = 0.0
    unexplained: list[str] = dataclasses.field(default_factory=list)  # what the causes leave open
    in_part: list[NamedCause] = dataclasses.field(default_factory=list)  # they leave more than the noise
    left_out: list[str] = dataclasses.field(default_factory=list)  # questions that failed, with the reason

    @property
    def is_empty(self) -> bool:
        """Whether nothing was found so far."""
        return not self.causes and not self.unexplained

    def test(self, evidence: Evidence, mend: str) -> bool:
        """Count a hypothesis, and name it as a cause if it holds."""
        self.tried += 1
        self.evidence.append(evidence)
        if evidence.holds:
            self.causes.append(NamedCause(evidence.hypothesis, evidence.magnitude, mend))
        return evidence.holds

    def ask(self, question: Callable[..., Any], *given: object, otherwise: Any = None) -> Any:
        """What a question finds; nothing, if a run that it needs fails.

        One that fails itself on what an engine gives is left out; then nothing is "no difference".
        """
        try:
            return question(*given)
        except Silent:
            return otherwise
        except FAILS as error:
            name = f"{question.__module__.rpartition('.')[2]}.{question.__name__}"
            self.left_out.append(f"{name} was left out: {type(error).__name__}: {error}")
            return otherwise

    def conclude(self) -> Explanation:
        """Settle the outcome and its sentence by the causes that were found and what these leave unexplained."""
        unexplained = [*self.unexplained, *(self.left_out if not self.causes else [])]
        self.outcome = "unresolved" if unexplained else "fail" if self.causes else "pass"
        who = f"{self.engine} {self.method} on {self.scene}"
        if self.outcome == "pass":
            self.sentence = (f"{who}: no difference beyond {max(self.deviation or 0.0, self.noise or 0.0):.1e} in the "
                             f"first {self.window:.3g} s" + (f"; verify says: {self.verdict}" if self.verdict else ""))
            return self
        text = " and ".join(map(str, self.causes))
        if self.outcome == "unresolved":
            parts = [*self.causes, *self.in_part]
            text = "; ".join(["unknown", *unexplained, *(
                [f"{self.tried} hypotheses tried"] if self.tried else []), *(
                [f"each of these would do: {', '.join(self.candidates)}"] if self.candidates else []), *(
                [f"in part: {' and '.join(map(str, parts))}"] if parts else [])])
        self.sentence = f"{who}: {text}; looked at: the first {self.window:.3g} s"
        return self

    @property
    def exit_code(self) -> int:
        """0: no difference; 1: causes named; 3: unknown."""
        return EXIT_CODES[self.outcome]

    @property
    def code(self) -> str:
        """That of the verdict; a limit that is the truth leaves what is wrong to the order."""
        at_truth = self.deviation is not None and self.noise is not None and self.deviation <= self.noise
        return code(self.outcome, "order" if at_truth else "limit")

    @property
    def ending(self) -> str:
        """The one change that would mend what is open; "" where nothing is."""
        if self.outcome != "unresolved":
            return ""
        return "what would mend it: " + (f"a start or a scene in which these differ: {', '.join(self.candidates)}" if (
            self.candidates) else "another --step or start, at which another part of the difference is seen")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes, sorted."""
        return tuple(sorted({cause.name for cause in self.causes}))

    def plain(self) -> dict[str, object]:
        """As values that JSON knows."""
        return dataclasses.asdict(self) | {"exit_code": self.exit_code, "code": self.code}
