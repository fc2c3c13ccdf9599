"""Formulas as pictures in the page (SVG), so that they need no script and no font of the reader's machine."""

from __future__ import annotations

from html import escape
from typing import Any

import ziamath
from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

logger = logging.getLogger(__name__)
ziamath.config.svg2 = False  # glyphs as paths: their names would be the same in all pictures of a page


def drawn(formula: str, *, inline: bool) -> str:
    """Return the picture of a formula in LaTeX; raises ValueError if it cannot be read."""
    try:
        known = "\\" not in convert(formula)
        picture = ziamath.Latex(formula, size=17.0 if inline else 18.0, color="currentColor", inline=inline)
        svg = picture.svg().replace("<svg ", f'<svg role="img" aria-label="{escape(formula)}" ', 1)
    except Exception as error:  # the libraries have a dozen, without a class in common
        raise ValueError(f"the formula cannot be read ({type(error).__name__}): {formula}") from error
    if not known:
        raise ValueError(f"the formula has a command that is not known: {formula}")
    # The lower edge of the picture is as far below the line of the text as its lowest glyph.
    return svg.replace("<svg ", f'<svg style="vertical-align: {picture.getyofst():.2f}px" ', 1) if inline else svg


def shown(self: Any, node: nodes.Element, tag: str, *, inline: bool) -> None:
    """Write a formula into the page, or a warning to Sphinx."""
    try:
        self.body.append(f'<{tag} class="formula">{drawn(node.astext(), inline=inline)}</{tag}>')
    except ValueError as error:
        logger.warning(str(error), location=node)
    raise nodes.SkipNode


def visit_inline(self: Any, node: nodes.math) -> None:
    """Write a formula within a sentence."""
    shown(self, node, "span", inline=True)


def visit_display(self: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own."""
    shown(self, node, "div", inline=False)


def setup(app: Any) -> dict[str, bool]:
    """Tell Sphinx that there is the renderer ``svg``."""
    app.add_html_math_renderer("svg", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
