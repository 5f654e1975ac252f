"""Formulas of the pages as MathML, made when the site is built: readable without a network.

`pymdownx.arithmatex` marks them; the font is `docs/fonts/stix-two-math.woff2`.
"""

from __future__ import annotations

import html
import re
from typing import Any

from math_core import LatexToMathML

_MARKED = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>', re.DOTALL)
_CONVERTER = LatexToMathML()


def on_page_content(page_html: str, **_: Any) -> str:
    """Called by MkDocs with a page's text: sets its formulas."""
    return _MARKED.sub(_set, page_html)


def _set(marked: re.Match[str]) -> str:
    """One formula; what the converter does not know is an error that ends the build."""
    tag, text = marked[1], html.unescape(marked[2]).strip()
    displayed, tex = text.startswith(r"\["), text[2:-2].strip()
    if r"\tag" in tex:  # numbers stand in numbered environments only
        tex = rf"\begin{{equation}}{tex}\end{{equation}}"
    formula = _CONVERTER.convert_with_local_state(tex, displaystyle=displayed)
    return f'<{tag} class="formula">{formula}</{tag}>'
