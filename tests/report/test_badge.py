"""The badge: its counts, and that it is an image."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from crosscheck.report.exports import badge
from tests.history.store.documents import document, record


@pytest.mark.parametrize(("outcomes", "words", "colour"), [
    (["pass", "partly", "known"], "2 pass, 1 partly", "#1a7f37"),
    (["pass", "fail", "error"], "1 pass, 2 fail", "#b3261e"),
    (["unsupported"], "nothing ran", "#5f6368")])
def test_it_counts_runs_in_the_colour_of_the_verdict(outcomes, words, colour):
    root = ElementTree.fromstring(badge(document([record(outcome=each) for each in outcomes])))
    assert root.get("aria-label") == f"crosscheck: {words}"
    assert "".join(root.itertext()).strip().endswith(words)
    left, right = root.findall("{*}rect")
    assert right.get("fill") == colour
    assert int(left.get("width")) + int(right.get("width")) == int(root.get("width"))
