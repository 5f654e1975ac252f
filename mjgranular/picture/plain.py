"""Names in figures: anybody's, and not to be taken for formulas."""

from __future__ import annotations

from mjgranular.errors import one_line


def plain(text: str) -> str:
    """Return a text that matplotlib draws as it is: no formula between dollars, nothing left out.

    Labels that begin with an underscore would be missing from a legend.
    """
    lines = "\n".join(map(one_line, text.split("\n"))).replace("$", r"\$")
    return f" {lines}" if lines.startswith("_") else lines
