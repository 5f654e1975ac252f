"""The skin by which bodies press sand down: points of it, no farther apart than cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.relief.update import FOOT_DTYPE, FOOTPRINT_DTYPE


@dataclass(frozen=True)
class Footprint:
    """Points of the skin, body by body.

    Attributes:
        points: rows of `FOOTPRINT_DTYPE`.
        feet: rows of `FOOT_DTYPE`, one for each body.
    """

    points: np.ndarray
    feet: np.ndarray


def footprint_of(model: mujoco.MjModel, elements: np.ndarray, cell: float) -> Footprint:
    """The footprint of the elements of a law: of facets, of rods (their axes)."""
    rows, feet, count = [], [], 0
    for slot in range(len(np.unique(elements["slot"]))):
        mine = elements[elements["slot"] == slot]
        points = np.concatenate([_points_of(element, cell) for element in mine])
        rows.append(points)
        count += len(points)
        foot = np.zeros(1, FOOT_DTYPE)
        foot["body"], foot["end"] = mine["body"][0], count
        foot["reach"] = np.linalg.norm(points["point"], axis=1).max()
        feet.append(foot)
    return Footprint(np.concatenate(rows), np.concatenate(feet))


def _points_of(element: np.void, cell: float) -> np.ndarray:
    names = element.dtype.names or ()
    if "edges" in names:
        edges, normal = element["edges"], element["normal"]
        s, t = (_spread(np.linalg.norm(edge), cell) for edge in edges)
        shifts = s[:, None, None] * edges[0] + t[None, :, None] * edges[1]
        turns = s[:, None, None] * element["spread"][0] + t[None, :, None] * element["spread"][1]
        points = np.zeros(len(s) * len(t), FOOTPRINT_DTYPE)
        points["point"] = (element["point"] + shifts).reshape(-1, 3)
        normals = (normal + turns).reshape(-1, 3)
        points["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return points
    s = _spread(element["half_length"], cell)
    points = np.zeros(len(s), FOOTPRINT_DTYPE)
    points["point"] = element["center"] + s[:, None] * element["axis"]
    return points


def _spread(half: float, cell: float) -> np.ndarray:
    """Middles of equal parts of -1 to 1, no longer than a cell."""
    count = max(math.ceil(2 * half / cell), 1)
    return (2 * np.arange(count) + 1) / count - 1
