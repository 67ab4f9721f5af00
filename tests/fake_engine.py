"""An engine for tests: truth plus an error of a chosen order, which can provoke every verdict."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.errors import EngineError
from crosscheck.scene.states import States


@dataclasses.dataclass
class FakeEngine(Engine):
    """Errors of `size` h^p (1 + `further` h) t in every quantity, p = `real_order`; claims `claimed_order`."""

    claimed_order: int | None = 2
    real_order: int = 2
    size: float = 0.1
    further: float = 0.0  # 1/s
    held: frozenset = frozenset()
    refuses: str | None = None
    breaks: str | None = None

    name = "fake"
    checks_sizes = on_group = True
    methods = ("Plain", "Broken", "Unable")

    def version(self):
        return "1.2.3"

    def documented_order(self, scene, spec):
        return self.claimed_order

    def held_levels(self, scene, spec):
        return self.held

    def unsupported(self, scene, spec):
        return "it knows the motion from the scene's start alone" if scene.name == "elsewhere" else self.refuses

    def run(self, scene, spec):
        """Truth with the chosen error, or the chosen failure."""
        from crosscheck.references import truth

        if self.breaks:
            raise EngineError(self.breaks)
        per, h = steps_per_sample(scene, spec.step)
        # Two output times make a timing run; truth wants more of them, so it is taken from a finer grid.
        exact = truth(scene.replace(samples=6) if scene.samples == 2 else scene).states
        pick = [0, -1] if scene.samples == 2 else slice(None)
        error = self.size * h**self.real_order * (1 + self.further * h) * exact.t[pick]
        turn = np.broadcast_to(np.eye(3), (len(error), 3, 3)).copy()
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(error)
        turn[:, 1, 0], turn[:, 0, 1] = np.sin(error), -np.sin(error)
        push = error[:, None, None] * np.array([1.0, 0.0, 0.0])
        states = States(exact.t[pick], exact.x[pick] + push, exact.R[pick] @ turn[:, None], exact.v[pick] + push,
                        exact.w[pick] + push)
        return RawRun(states, 1e-6 * per * (scene.samples - 1), per * (scene.samples - 1), h, form="tree")


def install(monkeypatch, engine):
    """Make the engine the only one."""
    from crosscheck import adapters

    monkeypatch.setattr(adapters, "get", lambda name: engine)
    return engine
