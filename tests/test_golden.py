"""Recorded results are compared as `tools/golden.py` describes."""

from tools import golden


def test_a_golden_comparison_names_each_kind_of_difference_once():
    runs = [{"engine": "e1", "outcome": "pass", "error": 1e-3, "wall_time": 0.1},
            {"engine": "e2", "outcome": "pass", "error": None, "curve": 300 * "a"}]
    before = golden.flat("verify", {"records": runs, "meta": {"seconds": 3.0}})
    assert golden.compare(before, dict(before)) == []
    assert len(before) == 7  # no time
    runs[0] |= {"outcome": "fail", "error": 1.1e-3}
    runs[1] |= {"curve": 300 * "b"}
    lines = golden.compare(before, golden.flat("verify", {"records": runs[:2]}))
    assert lines[0] == "verify/records/e1/outcome: pass -> fail"
    assert [line.split(" differ")[0].split()[-3:] for line in lines[1:]] == [["1", "of", count] for count in "122"]
    assert any("at most by 9.1e-02: verify/records/e1/error: 0.001 -> 0.0011" in line for line in lines)
    assert golden.compare(before, {}) == ["7 values only before, for one verify/records/e1/engine"]
