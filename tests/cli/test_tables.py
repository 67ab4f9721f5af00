"""Tables at three widths: no figure is cut, and each stands beside the name of its row."""

import re

import pytest
from rich.console import Console

from crosscheck.cli.console import figures, key, print_table, words

ROWS = [("double_pendulum", "lieeuler DAE1L_LSE (maximal)", *(f"{k}.234e-{k:02d}" for k in range(1, 10)),
         "a remark of some words that may be folded"),
        ("heavy_top", "mujoco RK4 (tree)", *(f"{k}.987e-{k:02d}" for k in range(1, 10)), "")]
COLUMNS = [key("scene"), key("run"), *figures(*(f"figure {k}, m/s" for k in range(1, 10))), words("remark")]


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_no_figure_is_cut_and_no_line_is_too_long(width, capsys):
    terminal = Console(width=width, highlight=False)
    print_table(terminal, COLUMNS, ROWS)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert all(word in " ".join(lines) for word in ("figure", "m/s", "double_pendulum", "DAE1L_LSE"))
    for row in ROWS:
        for figure in row[2:-1]:
            (line,) = (line for line in lines if re.search(rf"(^|\s){re.escape(figure)}(\s|$)", line))
            assert row[0] in line  # each block names its rows


def test_a_wide_terminal_has_one_block_and_a_narrow_one_several(capsys):
    heads = {}
    for width in (80, 200):
        print_table(Console(width=width), COLUMNS, ROWS)
        heads[width] = capsys.readouterr().out.count("scene")
    assert heads[200] == 1 < heads[80]


def test_brackets_are_text(capsys):
    print_table(Console(width=80), [key("item"), *figures("exudyn")], [("hinge", "2/5 [5]")])
    assert "2/5 [5]" in capsys.readouterr().out


def test_failures_are_told_as_they_occur(capsys):
    from crosscheck.cli.console import progress_bar
    from crosscheck.jobs.drive import Stages

    with progress_bar() as progress:
        stages = Stages(1, None, lambda label: progress(1, 2, label))
        stages.run("cell", abs, [-1, 2], ["a", "b"], ["first", "second"],
                   failure=lambda result: "too large" if result > 1 else "")
    assert capsys.readouterr().err.splitlines() == ["✗ second: too large"]
