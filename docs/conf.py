"""How Sphinx makes the site of these documents: `make docs` writes it into build/docs."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import json
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils.nodes import math, math_block
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "lieeuler + crosscheck"
author = project_copyright = "The lieeuler-crosscheck authors"
release = importlib.metadata.version("lieeuler-crosscheck")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "myst-nb"}
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 300
napoleon_google_docstring = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say types, with shapes and units
html_math_renderer = "mathml"
html_theme = "furo"  # light and dark, any width, and a search that needs no server
html_title = "lieeuler + crosscheck"
html_theme_options = {"footer_icons": []}
highlight_language = "bash"  # of blocks that name none: commands
html_show_sourcelink = False
html_static_path = ["static"]

os.environ["PATH"] = os.pathsep.join([os.path.dirname(sys.executable), os.environ["PATH"]])  # notebooks call crosscheck
DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))  # gallery.py and reference.py are beside this file
import reference  # noqa: E402

ELSEWHERE = {"readme": "README.md", "changes": "CHANGELOG.md", "contributing": "CONTRIBUTING.md"}
"""Pages whose text stands elsewhere in the repository."""

LINK = re.compile(r"\]\(([^)#:\s]+)(#[^)\s]*)?\)")


def take(app: Sphinx, docname: str, source: list[str]) -> None:
    """Give pages their text from elsewhere, and let links lead to pages of the site."""
    home = DOCS.parent / ELSEWHERE.get(docname, f"docs/{docname}.md")
    if docname in ELSEWHERE:
        source[0] = home.read_text(encoding="utf-8")

    def led(link: re.Match[str]) -> str:
        target = os.path.normpath(home.parent / link[1])
        page = next((f"{name}.md" for name, path in ELSEWHERE.items() if target == str(DOCS.parent / path)), None)
        return f"]({page or os.path.relpath(target, (DOCS / docname).parent)}{link[2] or ''})"

    source[0] = LINK.sub(led, source[0]) + MADE.get(docname, str)()


def drawn(name: str) -> str:
    """What a function of gallery.py draws."""
    return str(getattr(importlib.import_module("gallery"), name)())


MADE = {"commands": reference.commands, "verdicts": reference.verdicts, "engine-modes": reference.engines,
        "lieeuler": reference.methods, "adding-a-scene": reference.scene_files,
        "adding-an-engine": reference.declarations, "results-schema": reference.fields,
        "speed": reference.speed,
        "scenes": functools.partial(drawn, "gallery"), "papers": functools.partial(drawn, "gains")}
"""What is added to a page when the site is built."""

TAG = re.compile(r"\\tag\{([^}]*)\}")


def formula(writer: HTML5Translator, node: math | math_block) -> None:
    """A formula as MathML, which browsers draw by themselves, with its number beside it: pages need no network."""
    from docutils.nodes import SkipNode
    from docutils.utils.math.latex2mathml import tex2mathml

    text, block = node.astext(), node.tagname == "math_block"
    number = TAG.search(text)
    text = re.sub(r"\\dots\b", r"\\ldots", TAG.sub("", text)).strip()
    text = re.sub(r"\\(d?dot|hat) ?(\w)(?=[_^])", r"\\\1 \2{}", text)  # else the index would stand below
    drawn = tex2mathml(text, as_block=block)
    beside = f"({number[1]})" if number else ""
    writer.body.append(f'<div class="formula" tabindex="0">{drawn}<span>{beside}</span></div>' if block else drawn)
    raise SkipNode


ACCESS = [(re.compile(pattern), better) for pattern, better in (
    (r'role="heading"', 'role="heading" aria-level="2"'),
    (r'<aside class="sidebar-drawer"', r'\g<0> aria-label="pages"'),
    (r'<aside class="toc-drawer[^"]*"', r'\g<0> aria-label="on this page"'),
    (r'(id="furo-main-content">\s*)(?=<noscript>)', r'\1<h1 class="unseen">Search</h1>'),
    (r"<pre(?=>)", '<pre tabindex="0"'),  # what scrolls sideways is reached by keys, too
    (r'<div class="table-wrapper[^"]*"', r'\g<0> tabindex="0"'),
    (r'<th class="head[^"]*"><p></p></th>', "<td></td>"),
    (r'(<th class="head[^"]*"><p>)(?=<math)', r'\1<span class="unseen">symbol</span>'))]
"""What the pages of the theme lack for readers of screens and users of keys, as axe finds it."""


def finish(app: Sphinx, error: Exception | None) -> None:
    """Write the JSON Schema of results.json beside the pages, and mend these."""
    from crosscheck.report.schema import json_schema

    (Path(app.outdir) / "results-schema.json").write_text(json.dumps(json_schema(), indent=1), encoding="utf-8")
    for page in Path(app.outdir).rglob("*.html") if error is None else ():
        text = page.read_text(encoding="utf-8")
        for pattern, better in ACCESS:
            text = pattern.sub(better, text)
        page.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Sphinx calls this."""
    app.connect("build-finished", finish)
    app.connect("source-read", take)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.add_css_file("site.css")
