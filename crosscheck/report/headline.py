"""Numbers and outcomes in words for a reader."""

from __future__ import annotations

import math
import os
import shlex
from collections import Counter
from collections.abc import Sequence

from crosscheck.document import QUANTITIES, Change, Document, Record, Scene, grouped
from crosscheck.document.outcomes import Outcome, percent
from crosscheck.errors import counted

OUTCOMES: dict[Outcome, tuple[str, str, str]] = {
    "pass": ("✓", "pass", "comes to the truth as documented, resolved over all that was asked for"),
    "known": ("≈", "known", "only defects of the engine that are listed with their reason"),
    "fail": ("✗", "fail", "a figure is beyond its bound"),
    "error": ("‼", "error", "it did not run"),
    "unresolved": ("?", "unresolved", "nothing is beyond its uncertainty, but that is too large to tell over more of "
                   "the run than was asked for; the run says why"),
    "unsupported": ("–", "unsupported", "the engine cannot model this scene")}
"""Symbol, word and meaning of each outcome."""


def share_words(records: Sequence[Record]) -> str:
    """In words, over what share of its time every row of a run is resolved, the least and the most of several runs."""
    least, most = (percent(each([record.least_share for record in records])) for each in (min, max))
    return f"resolved over {'' if least == most else least.removesuffix(' %') + ' to '}{most} of the time"


def assumptions(records: Sequence[Record]) -> list[str]:
    """What runs set otherwise than their engines have it by themselves, a sentence an engine."""
    found = {record.engine: record.assumed for record in records if record.assumed}
    return [f"{engine} is run with {assumed}: what it solves softly (friction, limits, joints that close loops) is as "
            "stiff as the step allows, so that it can come to the model; --set softness=default judges it as it is"
            for engine, assumed in found.items()]


SPARED = 2
"""Most failing runs, changes or scenes that a headline names. Of more it only gives the number."""


def headline(document: Document) -> str:
    """The result in one sentence: what passes and fails, what became worse, what was not judged and why.

    The first page, summary.md and the summary of a nightly run begin with it, after `Document.answers`.
    """
    if not document.records and document.meta.left:
        return "no run has ended yet" + ("" if document.scenes else ": truth is being computed, which every run needs")
    if not document.records:
        return "Nothing was run"
    clauses = (_passing(document), _cut(document), _worse(document.changes), _not_judged(document.scenes),
               _ended(document.scenes))
    return "; ".join(clause for clause in clauses if clause)


NAMED = 3
"""Most runs that an answer names."""


def within(record: Record, kind: str, need: float) -> tuple[str, ...]:
    """Whether a run is within a tolerance that the user asked for, and its error; empty where that was not asked.

    Not decided: it was within as far as truth reaches, and that is less of the run's time than `need`.
    """
    each = next((each for each in record.findings if each.kind == kind), None)
    if each is None:
        return ()
    if each.value is None:  # JSON has neither infinity nor NaN
        return ("no", "infinite") if each.status == "fail" else ("not decided", "not known")
    word = "no" if each.status == "fail" else "yes" if record.shares.get(kind, 0.0) >= need else "not decided"
    return word, f"{number(each.value)} {each.unit}".removesuffix(" 1")


def tolerances(records: Sequence[Record]) -> dict[str, tuple[str, str]]:
    """The tolerances that the user asked for, by the kind of their findings: row and bound in words."""
    return {each.kind: (each.row, f"allowed {each.bound:g} {each.unit}".removesuffix(" 1"))
            for record in records for each in record.findings if each.about == "tolerance"}


def answers(records: Sequence[Record], need: float, wanted: Sequence[tuple[str, float]] = ()) -> list[str]:
    """Whether runs are within each tolerance that the user asked for, as `within`: of one run, or which of several.

    `wanted`: all that were asked for, also those by which no run could be judged.
    """
    found = tolerances(records)
    return [_answer(kind, *asked, [record for record in records if any(each.kind == kind for each in record.findings)],
                    need) for kind, asked in found.items()] + [
        f"not decided: error of {row}, allowed {bound:g} {QUANTITIES.get(row, '')}".rstrip() + ": no run was judged"
        for row, bound in wanted if records and f"tolerance {row}" not in found]


def _answer(kind: str, row: str, allowed: str, records: Sequence[Record], need: float) -> str:
    sizes, times = {_size(record) for record in records}, {_time(record, kind) for record in records}
    scenes = len({record.scene for record in records}) > 1
    words = grouped(records, lambda record: within(record, kind, need)[0])

    def several(runs: Sequence[Record]) -> str:
        named = ", ".join(
            f"{os.path.basename(record.label)}{f' on {spoken(record.scene)}' * scenes}"
            f"{_size(record) * (len(sizes) > 1)} {within(record, kind, need)[1]}"
            f"{_time(record, kind) * (len(times) > 1)}"
            for record in sorted(runs, key=lambda record: -max(
                each.severity for each in record.findings if each.kind == kind))[:NAMED])
        return f"{counted(len(runs), 'run')} ({named}{f' and {len(runs) - NAMED} more' * (len(runs) > NAMED)})"

    if len(records) == 1:
        word, value = within(records[0], kind, need)
        return (f"{word}: error of {row} {value}{min(times)}, {allowed}: {os.path.basename(records[0].label)}"
                f"{min(sizes)}")
    common = "".join(min(each) for each in (sizes, times) if len(each) == 1)
    return f"error of {row}, {allowed},{common}: " + ", ".join(
        f"{word} for {several(words[word])}" for word in ("no", "not decided", "yes") if word in words)


def _size(record: Record) -> str:
    return f" at {record.size}" if record.size else ""


def _time(record: Record, kind: str) -> str:
    """The part of the time that was asked for over which a row was compared."""
    share = record.shares.get(kind, 0.0)
    return f" over all {record.duration:g} s" if share >= 1 and record.duration else (
        f" over {percent(share)} of the time")


def _cut(document: Document) -> str:
    """The steps that were made where the one that was asked for divides no interval between outputs."""
    asked = document.meta.asked.step
    made = {record.size for record in document.records if record.step and asked and not math.isclose(
        record.step, asked, rel_tol=1e-9)}
    return "" if not made else (f"steps of {' and '.join(sorted(made))} were made, not of {asked:g} s, which does not "
                                "divide the time between two outputs")


def _passing(document: Document) -> str:
    """The numbers of passes, known defects and failures. Scenes that could not be prepared are left out."""
    lost = {scene.name for scene in document.scenes if scene.failure}
    records = [record for record in document.records if record.scene not in lost]
    count = Counter(record.outcome for record in records)
    failing = [record for record in records if record.outcome in ("fail", "error")]
    open_ = [record for record in records if record.outcome == "unresolved"]
    if count["pass"] and count["pass"] + count["unsupported"] == len(records):
        made = "that could be made " if count["unsupported"] else ""
        return f"The only run {made}passes" if count["pass"] == 1 else f"All {count['pass']} runs {made}pass"
    whole = count["pass"]
    said = [f"{counted(whole, 'run', none='No')} pass{'es' if whole == 1 else ''}"]
    if open_:
        reasons = Counter(record.not_judged for record in open_ if record.not_judged).most_common(1)
        why = f", {'mostly ' if len(open_) > 1 else ''}since {reasons[0][0].partition(': ')[0]}" if reasons else ""
        said.append(f"{len(open_)} unresolved ({share_words(open_)}{why})")
    if count["known"]:
        said.append(f"{count['known']} show{'s' if count['known'] == 1 else ''} only known defects")
    if 0 < len(failing) <= SPARED:
        named = " and ".join(f"{os.path.basename(record.label)} on {spoken(record.scene)}" for record in failing)
        said.append(f"{len(failing)} fail{'s' if len(failing) == 1 else ''} ({named})")
    elif failing:
        said.append(f"{len(failing)} fail on {counted(len({record.scene for record in failing}), 'scene')}")
    elif whole + len(open_):
        said.append("none fails")
    return ", ".join(said)


def _worse(changes: Sequence[Change] | None) -> str:
    """What became worse; "" if there was no run to compare with."""
    if changes is None:
        return ""
    named = [change.kind + (f" ({where})" if where else "") for change in changes if change.bad
             for where in [" on ".join(filter(None, (change.who, spoken(change.scene))))]]
    return f"worse than before: {_some(named)}" if named else "nothing is worse than before"


def _some(named: Sequence[str], more: str = "more") -> str:
    """The first of several, and how many more there are."""
    rest = f" and {len(named) - SPARED} {more}" if len(named) > SPARED else ""
    return ", ".join(named[:SPARED]) + rest


def _ended(scenes: Sequence[Scene]) -> str:
    """The scenes whose claim a monitor ends before their duration."""
    return _some([f"{spoken(scene.title)} is judged until {scene.truth.ended}" for scene in scenes
                  if scene.truth is not None and scene.truth.ended], "scenes more are judged up to a monitor")


def _not_judged(scenes: Sequence[Scene]) -> str:
    """The scenes without truth, and the first clause of the reason."""
    reasons = [(spoken(scene.title), reason.removeprefix(f"{scene.title!r}: ").partition("; ")[0].rstrip("."))
               for scene in scenes if (reason := scene.failure or scene.no_truth)]
    if len(reasons) < 2:
        return "".join(f"{name} could not be judged: {reason}" for name, reason in reasons)
    return f"{len(reasons)} scenes could not be judged: " + _some([f"{name} ({reason})" for name, reason in reasons])


def advice(scene: Scene) -> str:
    """Which runs of a scene to trust, and which not, in words."""
    return scene.trust + (f" Not to be trusted here: {', '.join(scene.not_trusted)}." if scene.not_trusted else "")


def span(record: Record) -> str:
    """In words, over what part of its length every row of a run is resolved."""
    if record.share is None or record.duration is None:
        return ""
    if record.least_share < 1:
        return f"{percent(record.least_share)} of {record.duration:g} s" + (
            f", since {record.not_judged}" if record.not_judged else "")
    return f"all {record.duration:g} s"


def number(value: float | None, digits: int = 2) -> str:
    """A number with few digits; a dash for None."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    if 10**digits <= abs(value) < 1000:
        return f"{value:.0f}"
    return f"{value:.{digits}g}" if 0.01 <= abs(value) < 1000 else f"{value:.{digits - 1}e}"


ROW = ("scene", "run", "verdict", "step or rtol", "order", "error of its size", "would have shown", "resolved",
       "energy error", "us/step")
"""Titles of `row`."""


def row(record: Record) -> tuple[str, ...]:
    """A run as a row of a table in a terminal or notebook."""
    return (record.scene, record.label, f"{OUTCOMES[record.outcome][0]} {record.word}", record.size,
            "" if record.order is None else f"{record.order.observed:.2f}", brief(record.off),
            brief(visible_error(record)), "" if record.share is None else percent(record.least_share),
            brief(record.energy_error), "" if record.us_per_step is None else f"{record.us_per_step:.3g}")


def brief(value: float | None) -> str:
    """A number with two digits; "" for None."""
    return "" if value is None else f"{value:.1e}" if value < 0.1 or value >= 1000 else f"{value:.2f}"


def sentence(record: Record) -> str:
    """The worst finding of a run in one clause, with its code where it is not passed."""
    return f"{record.code}: {clause(record)}" if record.code else clause(record)


def clause(record: Record) -> str:
    """The worst finding of a run in words."""
    worst = record.worst
    if record.outcome in ("error", "unsupported", "unresolved") or worst is None:
        return record.message
    if worst.value is None:
        return worst.detail or worst.why
    unit = "" if worst.unit in ("1", "") else f" {worst.unit}"
    if worst.about == "order" and record.order is not None:
        return f"observed order {number(record.order.observed, 3)}, documented {record.order.documented}"
    relation = "within" if worst.status == "ok" else "beyond"
    what = {"limit": "as steps vanish {row} is off by", "gap": "from its own states {row} goes on otherwise by",
            "promise": "{row} is off by", "tolerance": "error of {row}"}.get(worst.about, "{row}")
    return (f"{what.format(row=worst.row)} {number(worst.value)}{unit}, {relation} {number(worst.bound)}{unit}")


MENDS = {"unresolved elsewhere": "starts from other states: there, bodies and joints have other names and order",
         "unresolved dropped": "a start at which nothing acts that was left out: --qpos or --keyframe",
         "unresolved rest": "give it a start that moves",
         "unresolved truth": "a shorter --duration, or a scene with a truth: crosscheck truth says what is in the way"}
"""By the kind of a finding that says why nothing of a motion was judged: the change that would mend it."""


SCRIPTED = {"--engine", "--method", "--step", "--duration", "--keyframe", "--qpos", "--qvel"}
"""The options that `crosscheck run --script` takes, whose script needs MuJoCo alone."""


def ending(record: Record, command: str = "") -> str:
    """How a verdict ends: the command that reproduces what is wrong, or the one change that would mend what is open."""
    if record.outcome == "unresolved":
        return f"what would mend it: {_mend(record)}"
    if record.outcome not in ("fail", "error"):
        return ""
    command = command or record.command.partition(" --samples ")[0]
    scripted = record.engine.partition("==")[0] == "mujoco" and record.step is not None
    given = {word for word in shlex.split(command) if word.startswith("--")}
    if command.startswith("crosscheck run ") and scripted and given <= SCRIPTED:
        command += " --script"
    return f"reproduce: {command}" if command else ""


def _below(value: float) -> str:
    """Two digits of a number, rounded down."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / digit * (1 + 1e-12)) * digit:.2g}"


def _mend(record: Record) -> str:
    open_ = {each.kind: each.value for each in record.findings if each.status == "unresolved"}
    share = f", or --need {_below(record.least_share)}, which is resolved" if record.least_share else ""
    if share and (ends := open_.get("unresolved ended")):
        return f"--duration {_below(ends)}, before truth ends{share}"
    return next((mend for kind, mend in MENDS.items() if kind in open_),
                f"a smaller {'--step' if record.step else '--rtol'}{share}")


def visible_error(record: Record) -> float | None:
    """An error of the model that moves the motion by more than this, over the size, would have been seen."""
    return max((record.resolution[name] for name in QUANTITIES if name in record.resolution), default=None)


SHADES = (1e-9, 1e-6, 1e-3, 1e-1)
"""Errors in the scene's own size at which their colour changes: rounding, fine, seen in a plot, another motion."""


def shade(record: Record) -> int:
    """The number of its colour, by the size of its error and not by its verdict."""
    return sum(record.off is None or not record.off <= most for most in SHADES)


def plain_number(value: float | None) -> str:
    """A number by which a table can be sorted; "" for None."""
    return "" if value is None else f"{value:.6g}"


def spoken(name: str) -> str:
    """A name with spaces instead of underscores, for headings; of a path the file's name."""
    return os.path.basename(name) if os.sep in name else name.replace("_", " ")
