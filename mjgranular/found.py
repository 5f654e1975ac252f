"""Errors of laws against measured motion: written by `python referee/validate.py`, not by hand."""

FOUND: dict[str, tuple[tuple[float, float, float, int], ...]] = {}
"""By law: greatest Froude number, least width in grains, worst error, number of runs."""

SOURCE = "docs/validity.md"
