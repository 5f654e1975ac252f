"""Stresses on tilted plates, as measured: table S5 of Li, Zhang and Goldman 2013."""

import csv
from functools import cache
from pathlib import Path

import numpy as np

TILTS, ATTACKS = 7, 13
"""Tilts from -90 to 90 degrees in steps of 30; attacks from -90 to 90 degrees, at tangents or
cotangents of 0, 1/3, 2/3 and 1."""


@cache
def measured_stresses() -> dict[str, np.ndarray]:
    """Return alpha_z and alpha_x by the names of the media [N/cm^3], shape (2, TILTS, ATTACKS)."""
    with Path(__file__).with_name("stresses.csv").open(encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    numbers = np.array(rows, float).T[2:].reshape(-1, 2, TILTS, ATTACKS)
    return dict(zip((name.split()[0] for name in head[2::2]), numbers, strict=True))
