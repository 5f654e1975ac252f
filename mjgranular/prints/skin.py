"""The skin that prints are drawn with: vertices of a grid, which are put where the sand is.

MuJoCo's viewers and renderers take the vertices of a skin anew for every picture, so a picture can
have a shape of its own wherever it is drawn. A skin has no part in the physics. Its grid is wrapped
around as that of the memory is: node (i, j) has the vertex (i mod n, j mod n), and keeps the grains
that are drawn on it when the robot walks on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.relief.memory import EXTENT, Memory

SKIN = "mjgranular_prints"
"""Name of the skin; behind a space that of the sand."""

BLOCK = 10
"""Nodes along the side of a block, which is drawn with the skin or as a rectangle as a whole."""

_MOST = 400
"""Nodes along a side that are drawn. Chosen: 12 MB of vertices, normals and texture places."""


def stride_of(memory: Memory) -> int:
    """Every how many-th node is drawn: as few are left out as a window of `EXTENT` allows."""
    return math.ceil(min(memory.size, EXTENT / memory.cell - 1e-9) / _MOST)


def lines_of(memory: Memory) -> int:
    """Number of vertices along a side: those that are drawn, and a block around, which is not."""
    shown = BLOCK * math.ceil(memory.size / (BLOCK * stride_of(memory)))
    return min(shown, _MOST) + 2 * BLOCK


def vertex_count(lines: int) -> int:
    """Number of vertices: of the surface, and of walls at four sides, upper and lower edge."""
    return lines * lines + 4 * 2 * (lines + 2)


def add_skin(
    spec: mujoco.MjSpec,
    memory: Memory,
    material: str,
    *,
    sand: str = "sand",
    rgb: Sequence[float] = (1.0, 1.0, 1.0),
    thickness: float = 0.0,
) -> None:
    """Adds the skin of a sand to a model that has it not.

    MuJoCo does not show it by itself, as it is transparent, but fills in its vertices and normals
    for whoever does.

    Args:
        spec: the model to be; its physics stay as they are, to the last bit.
        memory: of the sand.
        material: name of the material of what is to be seen.
        sand: name of the sand.
        rgb: colour that the material is multiplied with.
        thickness: of the sand, where its walls are seen [m].
    """
    name = f"{SKIN} {sand}"
    if any(skin.name == name for skin in spec.skins):
        return
    lines = lines_of(memory)
    count = vertex_count(lines)
    spec.add_skin(
        name=name,
        material=material,
        rgba=[*rgb, 0.0],
        vert=np.zeros(3 * count),
        texcoord=_texture(lines, stride_of(memory) * memory.cell, thickness).ravel(),
        face=_faces(lines).ravel(),
        bodyname=["world"],
        bindpos=[0, 0, 0],
        bindquat=[1, 0, 0, 0],
        vertid=[list(range(count))],
        vertweight=[[1.0] * count],
    )


def skin_of(model: mujoco.MjModel, sand: str = "sand") -> int:
    """The id of the skin of a sand of that name; -1 for none."""
    for number in range(model.nskin):
        if model.skin(number).name.replace(f"{SKIN} ", "") == sand:
            return number
    return -1


def _faces(lines: int) -> np.ndarray:
    """Triangles, counter-clockwise as seen from outside, shape (n, 3)."""
    i, j = np.meshgrid(np.arange(lines), np.arange(lines), indexing="ij")
    ahead, beside = (i + 1) % lines, (j + 1) % lines
    a, b, c, d = (x * lines + y for x, y in ((i, j), (ahead, j), (ahead, beside), (i, beside)))
    faces = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    parts = [np.stack(faces, axis=2).reshape(-1, 3)]
    for side in range(4):
        first = lines * lines + side * 2 * (lines + 2)
        k = first + 2 * np.arange(lines + 1)  # upper edge; the lower one follows
        wall = np.concatenate(
            [np.stack([k, k + 1, k + 3], axis=1), np.stack([k, k + 3, k + 2], axis=1)]
        )
        # Outside is to the right along the first and the last.
        parts.append(wall if side in (0, 3) else wall[:, ::-1])
    return np.concatenate(parts)


def _texture(lines: int, cell: float, thickness: float) -> np.ndarray:
    """Places in the picture of grains [m], shape (n, 2).

    They go up and down again around the grid, which so has no seam; grains are the same mirrored.
    """
    around = np.arange(lines)
    there = cell * np.minimum(around, lines - around)
    top = np.stack(np.meshgrid(there, there, indexing="ij"), axis=-1).reshape(-1, 2)
    along = cell * np.repeat(np.arange(lines + 2), 2)
    below = np.tile([0.0, thickness], lines + 2)
    wall = np.stack([along, below], axis=1)
    return np.concatenate([top, np.tile(wall, (4, 1))])
