"""TeX of the pages as MathML, which browsers draw by themselves: no script and no font is loaded."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

# what pymdownx.arithmatex leaves of $…$ and $$…$$
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def with_mathml(page: str) -> str:
    """A page (HTML) with its formulas as MathML."""
    return FORMULA.sub(_formula, page)


def _formula(found: re.Match[str]) -> str:
    tag, tex = found.groups()
    block = tag == "div"
    formula = convert(html.unescape(tex).strip(), display="block" if block else "inline")
    return f'<div class="formula">{formula}</div>' if block else formula
