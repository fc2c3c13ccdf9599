"""Sphinx's configuration of the website; build.py calls Sphinx with it."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import dafw.core.accessor  # noqa: F401  (its class is documented)

sys.path.insert(0, str(Path(__file__).parent))

project = "dafw"
copyright = "the authors of dafw"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "formulas"]
html_math_renderer = "svg"
highlight_language = "none"
smartquotes = False  # texts as they are written

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4  # the same as on code hosts
myst_dmath_double_inline = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = "dafw"
html_static_path = [str(Path(__file__).parent / "static")]
html_css_files = ["website.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "default"
pygments_dark_style = "github-dark"


COLUMNS = re.compile(r"(\S(?:.*?\S)?) {2,}(\S.*)")


def list_columns(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Make a list of definitions of what a docstring writes in columns: several lines of a name, spaces and a text."""
    paragraphs = "\n".join(lines).split("\n\n")
    for number, paragraph in enumerate(paragraphs):
        found = [COLUMNS.fullmatch(line) for line in paragraph.split("\n")]
        if found[0] and sum(map(bool, found)) > 1:
            entries = zip(paragraph.split("\n"), found, strict=True)
            shown = [f"``{one[1]}``\n    {one[2]}" if one else f"    {line.strip()}" for line, one in entries]
            paragraphs[number] = "\n".join(shown)
    lines[:] = "\n\n".join(paragraphs).split("\n")


def setup(app: Any) -> None:
    """Tell Sphinx what is done with docstrings."""
    app.connect("autodoc-process-docstring", list_columns, priority=100)  # before the sections of napoleon
