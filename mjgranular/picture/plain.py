"""Names in figures: arbitrary strings, which must not be read as formulas."""

from __future__ import annotations

from mjgranular.errors import one_line


def plain(text: str) -> str:
    """Return a string that matplotlib draws literally: no formula between dollars, no omission.

    Labels that begin with an underscore would be missing from a legend.
    """
    lines = "\n".join(map(one_line, text.split("\n"))).replace("$", r"\$")
    return f" {lines}" if lines.startswith("_") else lines
