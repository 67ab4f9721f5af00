"""Every code block of every document does what it says, each by itself: Python runs, files are read, commands run.

A comment of the document directly above a block gives the context that it needs:

    <!-- run: as top.toml -->          the block is this file beside the document's other blocks
    <!-- run: after import crosscheck -->
    <!-- run: not, REASON -->

The fast suite reads every command as the command line does, and runs those that take no time; the slow tests run all,
shortened. docs/papers.md has a test of its own.
"""

from __future__ import annotations

import configparser
import dataclasses
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.history.runs import open_store, run_from_document, save
from crosscheck.judge import overrides
from crosscheck.report import schema
from crosscheck.sweeps import plan
from tests import ROOT
from tests.history.store.documents import document, record
from tests.scene.models.model_files import ARM_URDF
from tests.scene_making import ARM

BLOCK = re.compile(r"(?:<!-- run: (?P<how>[^\n]+) -->\n)?^```(?P<language>[\w{}-]*)[^\n]*\n(?P<text>.*?)^```$",
                   re.DOTALL | re.MULTILINE)
SHOWN = {"math", "{toctree}", "{eval-rst}", "{code-cell}", "{literalinclude}", "text"}
"""Blocks that are only read: formulas, parts of the site, cells that run when it is built, examples, output."""
QUICK = {"list", "convert", "history"}
SMOKE = "--profile smoke --jobs 1 --out out"
SHORTER = {
    "run": "--duration 0.1", "verify": SMOKE, "nightly": f"{SMOKE} --scene single_pendulum --engine lieeuler",
    "study work-precision": "--repeats 1 --time-limit 0.002 --no-bound --duration 0.1 --out out",
    "study drift": "--steps 2000 --out out",
    "-m benchmarks.fuzz": "--count 20", "-m benchmarks.interruption": "--bodies 8 --repeats 1",
    "-m pytest": "--collect-only"}
"""Added to a command, by how it begins; an option given twice counts as it is given last."""
ONE_SCENE = {"verify": "--scene single_pendulum --engine lieeuler", "study": "single_pendulum --engine lieeuler"}
"""Added to a command that leaves open what to run."""


@dataclasses.dataclass(frozen=True)
class Block:
    """A code block, and what the comment above it says."""

    document: str
    line: int
    language: str
    text: str
    how: str

    def told(self, word: str) -> str:
        """The text after a word of the comment."""
        return self.how.removeprefix(f"{word} ") if self.how.startswith(f"{word} ") else ""

    @property
    def commands(self) -> list[str]:
        """The commands of a shell block, of a workflow's steps, of a service."""
        text = self.text.replace("\\\n", " ")
        if self.language == "yaml":
            return re.findall(r"run: (.+)", text)
        if self.language == "ini":
            return re.findall(r"ExecStart=(.+)", text)
        return [line for line in text.splitlines() if line.strip()] if self.language in ("", "sh", "bash") else []


def blocks() -> list[Block]:
    """Those of all documents that a reader can run or copy."""
    found = []
    for path in [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text("utf-8")
        found += [Block(str(path.relative_to(ROOT)), text[:match.start("language")].count("\n") + 1, match["language"],
                        match["text"], match["how"] or "") for match in BLOCK.finditer(text)]
    return [block for block in found if block.language not in SHOWN and block.document != "docs/papers.md"]


BLOCKS = blocks()
RUN = [block for block in BLOCKS if not block.how.startswith("not")]
COMMANDS = [pytest.param(block, line, id=f"{block.document}:{block.line}:{number}")
            for block in RUN for number, line in enumerate(block.commands, 1)]


def words_of(command: str) -> list[str]:
    """Its words without the folder of the environment; none for what only sets up a shell."""
    words = shlex.split(command, comments=True)
    first = words[0].removeprefix(".venv/bin/").removeprefix("/home/crosscheck/lieeuler/.venv/bin/")
    return [] if first in (".", "export", "cat") else [first, *words[1:]]


def desk(block: Block, place, report=None) -> None:
    """A folder with the files that the commands of a document name: its own, the reader's, a report, a history."""
    for other in BLOCKS:
        if other.document == block.document and other.told("as"):
            (place / other.told("as")).write_text(other.text, "utf-8")
    (place / "examples").symlink_to(ROOT / "examples")
    engine = (ROOT / "examples" / "my_engine.py").read_text("utf-8")
    (place / "my_engine.py").write_text(engine + "\n\nMyEngine = PivotRK4\n", "utf-8")
    (place / "my_package").mkdir()
    (place / "my_package" / "integrators.py").write_text(engine + "\n\nSymplectic = PivotRK4\n", "utf-8")
    shutil.copy(ROOT / "scenarios" / "single_pendulum.toml", place / "my_scene.toml")
    (place / "robot.urdf").write_text(ARM_URDF, "utf-8")
    if report is not None:
        shutil.copytree(report, place / "reports" / "latest")
    if "crosscheck history" in block.text:
        (place / "reports" / "latest").mkdir(parents=True, exist_ok=True)
        (place / "reports" / "latest" / "results.json").write_text(json.dumps(schema.plain(document([record()]))))
        store = open_store(str(place / "reports" / "history.sqlite"))
        for day in (20, 21):
            content = document([record(scene=scene) for scene in ("heavy_top", "double_pendulum")],
                               started=f"2026-11-{day}T02:00:00+00:00")
            save(store, run_from_document(f"2026-11-{day}T02-00-00Z-00ff", content, good=True))
    if "robot.toml" in block.text:
        assert CliRunner().invoke(app, ["convert", str(place / "robot.urdf"), "-o", str(place / "robot.toml"), "--drop"
                                        ]).exit_code == 0


def shortened(words: list[str]) -> list[str]:
    """A shortened command."""
    line = " ".join(words)
    more = next((added for start, added in SHORTER.items() if line.startswith(start)), "")
    if words[0] == "verify" and "--scene" not in words:
        more += f" {ONE_SCENE['verify']}"
    if words[0] == "study" and (len(words) == 2 or words[2].startswith("-")):
        more += f" {ONE_SCENE['study']}"
    return [*words, *more.split()]


def test_documents_say_why_a_block_cannot_run():
    assert len(BLOCKS) > 40
    assert len(COMMANDS) > 60
    for block in BLOCKS:
        assert not block.how or block.how.split()[0] in ("as", "after", "not,", "part"), block
        assert not block.how.startswith("not") or len(block.told("not,")) > 10, block
        assert block.language in ("", "sh", "bash", "python", "toml", "yaml", "ini"), block


@pytest.mark.parametrize(("block", "command"), COMMANDS)
def test_a_command_is_understood(block, command, tmp_path, monkeypatch):
    words = words_of(command)
    if words and words[0] == "make":
        done = subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    if not words or words[0] != "crosscheck":
        return
    monkeypatch.chdir(tmp_path)
    desk(block, tmp_path)
    here, rest = get_command(app), words[1:]
    while hasattr(here, "commands") and rest:
        here, rest = here.commands[rest[0]], rest[1:]
    here.make_context("crosscheck", list(rest))  # raises where a word means nothing
    if words[1] in QUICK:
        assert_runs(words)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A report of one run."""
    out = tmp_path_factory.mktemp("report") / "latest"
    words = f"verify --profile smoke --jobs 1 {ONE_SCENE['verify']} --method rattle2 --out {out}"
    assert CliRunner().invoke(app, words.split()).exit_code == 0
    return out


@pytest.mark.parametrize(("block", "command"), COMMANDS)
def test_a_command_runs(block, command, report, tmp_path, monkeypatch):
    words = words_of(command)
    if not words or words[0] == "make":
        return  # the targets of the Makefile are what .ci/run calls
    desk(block, tmp_path, report)
    monkeypatch.chdir(tmp_path)
    for line in block.commands:
        if line.startswith("c++ "):  # what the block's other commands run
            subprocess.run(shlex.split(line), check=True)
    if words[0] in ("crosscheck", "c++"):
        return None if words[0] == "c++" else assert_runs(words)
    words = ["-m", *words] if words[0] == "pytest" else words[1:]
    done = subprocess.run([sys.executable, *shortened(words)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return None


def assert_runs(words: list[str]) -> None:
    """The command ends; exit code 1, for findings, is no fault."""
    done = CliRunner().invoke(app, shortened(words[1:]))
    assert isinstance(done.exception, SystemExit | None), (done.output, done.exception)
    assert done.exit_code in (0, 1), done.output


SESSION = re.compile(r"^\$ (crosscheck .+)\n((?:(?!\$ |```).*\n)+)", re.MULTILINE)
"""A command of the front page and what it prints, to the next one."""
SESSIONS = SESSION.findall((ROOT / "README.md").read_text("utf-8"))


def test_the_front_page_shows_three_answers():
    assert [command.split()[1] for command, _ in SESSIONS] == ["advise", "judge", "inspect"]


@pytest.mark.parametrize(("command", "shown"), SESSIONS, ids=[command.split()[1] for command, _ in SESSIONS])
def test_a_command_prints_what_the_front_page_shows(command, shown):
    """At 100 columns; the line of the cost is a time."""
    done = subprocess.run([sys.executable, "-m", "crosscheck", *shlex.split(command)[1:]], cwd=ROOT,
                          env={**os.environ, "COLUMNS": "100"}, capture_output=True, text=True)
    printed, expected = ([line.rstrip() for line in text.splitlines() if line.strip() and not line.startswith("cost ")]
                         for text in (done.stdout, shown))
    assert printed == expected, done.stderr


FIXTURES = re.compile(r"def test_\w+\(\w")


@pytest.mark.parametrize("block", [
    pytest.param(block, id=f"{block.document}:{block.line}") for block in RUN if block.language == "python"])
def test_python_runs(block, tmp_path, monkeypatch):
    desk(block, tmp_path)
    monkeypatch.chdir(tmp_path)
    text = "\n".join([block.told("after"), block.text])
    names: dict[str, object] = {"__name__": "block"}
    exec(compile(text, block.document, "exec"), names)
    for name, test in list(names.items()):
        if name.startswith("test_") and not re.search(rf"def {name}\(\w", text):
            test()
    if FIXTURES.search(text):
        (tmp_path / "test_block.py").write_text(text, "utf-8")
        done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--crosscheck-engine",
                               "lieeuler", "test_block.py"], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


READERS = {"compound_pendulum.toml": crosscheck.load_scene, "sweep.toml": plan.read, "my.toml": overrides.read}


@pytest.mark.parametrize("block", [block for block in RUN if block.language in ("toml", "ini")],
                         ids=lambda block: f"{block.document}:{block.line}")
def test_a_file_is_read(block, tmp_path):
    if block.language == "ini":
        assert configparser.ConfigParser(strict=False, interpolation=None).read_string(block.text) is None
        return
    content = tomllib.loads(block.text)
    if block.told("as"):
        (tmp_path / block.told("as")).write_text(block.text, "utf-8")
        assert READERS[block.told("as")](tmp_path / block.told("as"))
    elif block.told("part"):  # of a scene: each entry alone makes another arm
        for joint in content.get("joints", ()):
            scene = tomllib.loads(ARM)
            scene["joints"][0] |= joint
            (tmp_path / "arm.json").write_text(json.dumps(scene))
            assert crosscheck.load_scene(tmp_path / "arm.json").n == 1
        for force in content.get("forces", ()):
            (tmp_path / "arm.json").write_text(json.dumps(tomllib.loads(ARM) | {"forces": [force]}))
            assert len(crosscheck.load_scene(tmp_path / "arm.json").forces) == 1
        watched = {key: content[key] for key in ("shapes", "monitors") if key in content}
        (tmp_path / "arm.json").write_text(json.dumps(tomllib.loads(ARM) | watched))
        assert len(crosscheck.load_scene(tmp_path / "arm.json").monitors) == len(watched.get("monitors", ()))


def test_the_workflows_of_the_documents_are_workflows():
    import yaml

    for block in (block for block in RUN if block.language == "yaml"):
        workflow = yaml.safe_load(block.text)
        assert all(set(step) & {"run", "uses"} for job in workflow["jobs"].values() for step in job["steps"])


@pytest.mark.parametrize("wrong", [
    "crosscheck verify --scenes heavy_top", "crosscheck study wrk-precision", "crosscheck run heavy_top --step fast"])
def test_a_wrong_command_is_found(wrong, tmp_path, monkeypatch):
    block = Block("docs/wrong.md", 1, "sh", wrong + "\n", "")
    with pytest.raises((Exception, SystemExit)):
        test_a_command_is_understood(block, wrong, tmp_path, monkeypatch)


@pytest.mark.parametrize(("file", "wrong"), [
    ("cg3.py", ("24 / 17", "24 / 19")), ("variational.py", ("composition=MCLACHLAN_4", "composition=(0.5, 0.5)"))])
def test_methods_of_ones_own_pass_and_fail_with_a_wrong_digit(file, wrong, tmp_path, monkeypatch):
    """The page says that they pass: exit code 0; and that a misread weight is found."""
    (command,) = (line for block in BLOCKS if block.document == "docs/own-method.md" for line in block.commands
                  if file in line)
    example = (ROOT / "examples" / file).read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").mkdir()
    assert example.count(wrong[0]) == 1
    for text, code in ((example, 0), (example.replace(*wrong), 1)):
        (tmp_path / "examples" / file).write_text(text, "utf-8")
        done = CliRunner().invoke(app, [*words_of(command)[1:], "--jobs", "1", "--out", f"out{code}"])
        assert done.exit_code == code, done.output
