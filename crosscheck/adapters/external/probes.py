"""An engine that is known by its answers alone: files with the states of a simulator that somebody else runs.

A question is a scene and a step. Its file `NAME.json` holds the scene; the answer is the file `NAME.csv` beside it, or
`NAME.npz`, with the columns that `crosscheck.adapters.external.program` reads. `questions.csv` lists all of them.
"""

from __future__ import annotations

import csv
from pathlib import Path

from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.external.program import read_states
from crosscheck.errors import EngineError
from crosscheck.files import digest
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States


class Probes:
    """An engine in the sense of `crosscheck.adapters.external.own`.

    Parameters
    ----------
    folder : of questions and answers
    order : documented order of the method
    """

    methods = ("fixed",)

    def __init__(self, folder: Path, order: int) -> None:
        self.name, self.folder, self.orders = folder.name or "probes", folder, {"fixed": order}
        self.open = list[str]()  # names of questions without an answer

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """What the simulator cannot model shows in what it answers."""
        return None

    def ask(self, scene: Scene, step: float) -> str:
        """The name of a question; its file is written, if it is new."""
        text = scene.json()
        name = f"probe-{digest(text, step)[:10]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        path, known = self.folder / f"{name}.json", self.folder / "questions.csv"
        if not path.exists():
            path.write_text(text, encoding="utf-8")
            begun = known.exists()
            with known.open("a", newline="", encoding="utf-8") as stream:
                rows = csv.writer(stream)
                if not begun:
                    rows.writerow(["scene", "step [s]", "duration [s]", "outputs", "answer"])
                rows.writerow([path.name, repr(step), repr(scene.duration), scene.samples, f"{name}.csv"])
        return name

    def answer(self, name: str) -> Path | None:
        """The file that answers a question."""
        paths = (self.folder / f"{name}{end}" for end in (".csv", ".npz"))
        return next((path for path in paths if path.exists()), None)

    def run(self, scene: Scene, spec: RunSpec) -> States:
        """The answer; raises `EngineError` where there is none yet, and asks for it."""
        assert spec.step is not None
        name = self.ask(scene, spec.step)
        path = self.answer(name)
        if path is None:
            self.open.append(name)
            raise EngineError(f"{self.folder / name}.csv is not there yet")
        return read_states(self.name, scene, path)
