"""The Python in README.md does what it says."""

import re

import pytest

from tests import ROOT

SNIPPETS = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"),
                      re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("snippet", SNIPPETS, ids=[snippet.partition("\n")[0] for snippet in SNIPPETS])
def test_snippet(snippet):
    names = {"crosscheck": __import__("crosscheck")} if "import" not in snippet else {}
    exec(compile(snippet, "README.md", "exec"), names)
    for name, value in list(names.items()):
        if name.startswith("test_"):
            value()


def test_there_are_snippets():
    assert any("assert_agree" in snippet for snippet in SNIPPETS)
