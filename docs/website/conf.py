"""Sphinx's configuration of the website; build.py calls Sphinx with it."""

from __future__ import annotations

import sys
from pathlib import Path

import dafw.core.accessor  # noqa: F401  (its class is documented)

sys.path.insert(0, str(Path(__file__).parent))

project = "dafw"
copyright = "the authors of dafw"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "formulas"]
html_math_renderer = "svg"
highlight_language = "none"

myst_enable_extensions = ["dollarmath"]
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
