"""The engines run; right ones converge to references of their own mechanics, wrong ones are off by what is stated.

No verdict is asked for here. `table.csv` states the size of every effect; PYTHONPATH=. python tests/gate/measure.py
prints it anew.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.gate import measure
from tests.gate.measure import TABLE
from tests.gate.right import RIGHT
from tests.gate.wrong import WRONG


def test_the_table_is_complete():
    """Twenty right and thirty wrong engines, one row for each, with the documented order."""
    assert (len(RIGHT), len(WRONG)) == (20, 30)
    assert list(TABLE) == [cls.__name__ for cls in (*RIGHT, *WRONG)]
    for cls in (*RIGHT, *WRONG):
        assert TABLE[cls.__name__]["order"] == str(cls.order)
        assert TABLE[cls.__name__]["scene"] in [Path(name).stem for name in cls.scenes]


@pytest.mark.parametrize("cls", RIGHT, ids=lambda cls: cls.__name__)
def test_right_engine_converges(cls):
    """The error against DOP853 is what the table says, and falls at the documented order."""
    row = TABLE[cls.__name__]
    first, second = measure.errors(cls, row["quantity"])
    assert 0.5 < first / float(row["effect"]) < 2
    if cls.adaptive_methods:
        assert second < first / 20  # for a hundredth of the tolerance
    else:
        assert np.log2(first / second) == pytest.approx(cls.order, abs=0.4)


@pytest.mark.parametrize("cls", WRONG, ids=lambda cls: cls.__name__)
def test_wrong_engine_is_off(cls):
    """The largest difference from the right twin is what the table says, within a factor of 2."""
    row = TABLE[cls.__name__]
    assert 0.5 < measure.effects(cls)[row["quantity"]] / float(row["effect"]) < 2
