"""The skin that draws tracks: vertices of a grid that are moved to the surface of the sand.

MuJoCo's viewers and renderers read the vertices of a skin for every picture, so each picture can
have its own shape. A skin does not affect the physics. Its grid is wrapped around like that of the
memory: node (i, j) has the vertex (i mod n, j mod n), and the texture stays where it is.
"""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.relief.memory import EXTENT, Memory
from mjgranular.render.material import DEFAULT

SKIN = "mjgranular_prints"  # name of the skin; a space and the name of the sand follow

BLOCK = 10
"""Nodes along the side of a block, which is drawn as a whole, with the skin or as a rectangle."""

_MOST = 400
"""Drawn nodes along a side. Chosen: 12 MB of vertices, normals and texture coordinates."""


def stride_of(memory: Memory) -> int:
    """Return the smallest stride of drawn nodes for which a window of `EXTENT` fits."""
    return math.ceil(min(memory.size, EXTENT / memory.cell - 1e-9) / _MOST)


def lines_of(memory: Memory) -> int:
    """Return the number of vertices along a side: drawn ones, and a hidden block around them."""
    shown = BLOCK * math.ceil(memory.size / (BLOCK * stride_of(memory)))
    return min(shown, _MOST) + 2 * BLOCK


def vertex_count(lines: int) -> int:
    """Return the number of vertices: of the surface, and of four walls, upper and lower edge."""
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
    """Add the skin of a sand to a model, unless it has it; physics are the same to the last bit.

    MuJoCo does not draw it, since it is transparent, but computes its vertices and normals for code
    that does. Its color is the material's times `rgb`; `thickness` is that of visible sand [m].
    """
    name = f"{SKIN} {sand}"
    if any(skin.name == name for skin in spec.skins):
        return
    if np.allclose(rgb, DEFAULT[:3]) and (painted := spec.material(material)):
        rgb = painted.rgba[:3]  # MuJoCo takes that gray of a geom for no color
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
    """Return the id of the skin of a sand of that name; -1 for none."""
    names = [model.skin(number).name.replace(f"{SKIN} ", "") for number in range(model.nskin)]
    return names.index(sand) if sand in names else -1


def _faces(lines: int) -> np.ndarray:
    """Return triangles, counter-clockwise as seen from outside, shape (n, 3)."""
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
        # For the first and the last, outside is to the right along them.
        parts.append(wall if side in (0, 3) else wall[:, ::-1])
    return np.concatenate(parts)


def _texture(lines: int, cell: float, thickness: float) -> np.ndarray:
    """Return texture coordinates [m], shape (n, 2).

    They rise and fall around the grid, which therefore has no seam. Grains are mirrored about lines
    a quarter of the grid away from its middle, where robots start.
    """
    around = (np.arange(lines) + lines // 4) % lines
    there = cell * np.minimum(around, lines - around)
    top = np.stack(np.meshgrid(there, there, indexing="ij"), axis=-1).reshape(-1, 2)
    along = cell * np.repeat(np.arange(lines + 2), 2)
    below = np.tile([0.0, thickness], lines + 2)
    wall = np.stack([along, below], axis=1)
    return np.concatenate([top, np.tile(wall, (4, 1))])
