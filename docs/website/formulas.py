"""Formulas as pictures in the page (SVG), so that they need no script and no font of the reader's machine."""

from __future__ import annotations

from html import escape
from typing import Any

import ziamath
from docutils import nodes
from latex2mathml.converter import convert

ziamath.config.svg2 = False  # glyphs as paths: their names would be the same in all pictures of a page


def drawn(formula: str, *, inline: bool) -> str:
    """Return the picture of a formula in LaTeX; raises ValueError if a command in it is not known."""
    if "\\" in convert(formula):
        raise ValueError(f"the formula has a command that is not known: {formula}")
    picture = ziamath.Latex(formula, size=17.0 if inline else 18.0, color="currentColor", inline=inline)
    svg = picture.svg().replace("<svg ", f'<svg role="img" aria-label="{escape(formula)}" ', 1)
    # The lower edge of the picture is as far below the line of the text as its lowest glyph.
    return svg.replace("<svg ", f'<svg style="vertical-align: {picture.getyofst():.2f}px" ', 1) if inline else svg


def visit_inline(self: Any, node: nodes.math) -> None:
    """Write a formula within a sentence."""
    self.body.append(f'<span class="formula">{drawn(node.astext(), inline=True)}</span>')
    raise nodes.SkipNode


def visit_display(self: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own."""
    self.body.append(f'<div class="formula">{drawn(node.astext(), inline=False)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Tell Sphinx that there is the renderer ``svg``."""
    app.add_html_math_renderer("svg", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
