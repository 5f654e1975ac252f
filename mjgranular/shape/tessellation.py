"""Cuts the skin of a shape into facets: points, outward normals, areas, in the shape's own frame.

Curved skins are sampled finely on a grid of two parameters and gathered into coarser patches, so
that a patch's area and centroid are those of the curved skin and not of a flat polygon. Every cut
has the symmetries of its shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_FINE = 8  # samples a patch along each parameter; chosen, not measured


@dataclass(frozen=True)
class Facets:
    """Facets of a skin.

    Attributes:
        points: centroids [m], shape (n, 3).
        normals: unit, outward, shape (n, 3).
        areas: [m^2], shape (n,).
    """

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    def __len__(self) -> int:
        return len(self.areas)

    def __add__(self, other: Facets) -> Facets:
        return Facets(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.areas, other.areas]),
        )


def triangles(corners: np.ndarray) -> Facets:
    """Facets of triangles, one each; those without area are left out.

    Args:
        corners: shape (n, 3, 3), counter-clockwise seen from outside.
    """
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(doubled, axis=1)
    keep = size > 0
    return Facets(corners[keep].mean(axis=1), doubled[keep] / size[keep, None], size[keep] / 2)


def patches(
    skin: Callable[[np.ndarray, np.ndarray], np.ndarray], along: int, around: int
) -> Facets:
    """Facets of a skin given by two parameters in [0, 1].

    Args:
        skin: maps parameters u, v, each of shape (n, m), to points, shape (n, m, 3). du x dv points
            outward.
        along: number of patches over u.
        around: number of patches over v.
    """
    n, m = along * _FINE, around * _FINE
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    grid = skin(u, v)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    vector = 0.5 * np.cross(c - a, d - b)  # area times normal of a cell, exact for a flat one
    area = np.linalg.norm(vector, axis=2)
    middle = (a + b + c + d) / 4

    def gather(cells: np.ndarray) -> np.ndarray:
        shape = (along, _FINE, around, _FINE, *cells.shape[2:])
        return cells.reshape(shape).sum(axis=(1, 3)).reshape(along * around, *cells.shape[2:])

    areas = gather(area)
    keep = areas > 0  # the side of a capsule may have no length
    areas = areas[keep]
    if not len(areas):
        return Facets(np.zeros((0, 3)), np.zeros((0, 3)), areas)
    points = gather(middle * area[..., None])[keep] / areas[:, None]
    normals = gather(vector)[keep]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Facets(points, normals, areas)


def ellipsoid(radii: tuple[float, float, float], resolution: int) -> Facets:
    """An ellipsoid: `resolution` patches from pole to pole, twice as many around."""
    size = np.array(radii)

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        polar, turn = math.pi * u, 2 * math.pi * v
        unit = np.stack(
            [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1
        )
        return unit * size

    return patches(skin, resolution, 2 * resolution)


def tube(radius: float, half: float, along: int, around: int) -> Facets:
    """The side of a cylinder about z."""

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        turn = 2 * math.pi * v
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), half * (1 - 2 * u)], axis=-1)

    return patches(skin, along, around)


def disc(radius: float, height: float, rings: int, around: int) -> Facets:
    """A disc at that height, facing away from z = 0."""
    up = math.copysign(1.0, height)

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        turn = 2 * math.pi * v * up
        return np.stack(
            [radius * u * np.cos(turn), radius * u * np.sin(turn), np.full_like(u, height)],
            axis=-1,
        )

    return patches(skin, rings, around)


def cap(radius: float, height: float, rings: int, around: int) -> Facets:
    """A half sphere whose rim is at that height, bulging away from z = 0."""
    up = math.copysign(1.0, height)

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        polar, turn = math.pi / 2 * u, 2 * math.pi * v * up
        return np.stack(
            [
                radius * np.sin(polar) * np.cos(turn),
                radius * np.sin(polar) * np.sin(turn),
                height + up * radius * np.cos(polar),
            ],
            axis=-1,
        )

    return patches(skin, rings, around)


def cylinder(radius: float, half: float, resolution: int) -> Facets:
    """A cylinder about z with flat ends; `2 * resolution` patches around."""
    around = 2 * resolution
    along = _pieces(2 * half, radius, resolution)
    rings = max(2, resolution // 2)
    side = tube(radius, half, along, around)
    return side + disc(radius, half, rings, around) + disc(radius, -half, rings, around)


def capsule(radius: float, half: float, resolution: int) -> Facets:
    """A capsule about z; `2 * resolution` patches around."""
    around = 2 * resolution
    along = _pieces(2 * half, radius, resolution)
    rings = max(2, resolution // 2)
    side = tube(radius, half, along, around)
    return side + cap(radius, half, rings, around) + cap(radius, -half, rings, around)


def box(halves: tuple[float, float, float], resolution: int) -> Facets:
    """A box; `resolution` patches along its longest edge, at least 2 along each."""
    longest = max(halves)
    counts = [max(2, math.ceil(resolution * half / longest)) for half in halves]
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for side in (1.0, -1.0):

            def skin(
                u: np.ndarray,
                v: np.ndarray,
                axis: int = axis,
                first: int = first,
                second: int = second,
                side: float = side,
            ) -> np.ndarray:
                points = np.empty((*u.shape, 3))
                points[..., axis] = side * halves[axis]
                points[..., first] = side * halves[first] * (2 * u - 1)
                points[..., second] = halves[second] * (2 * v - 1)
                return points

            parts.append(patches(skin, counts[first], counts[second]))
    whole = parts[0]
    for part in parts[1:]:
        whole = whole + part
    return whole


def _pieces(length: float, radius: float, resolution: int) -> int:
    """Patches along a tube: about as long as they are wide, but not more than four a radius."""
    width = math.pi * radius / resolution
    return int(np.clip(math.ceil(length / (2 * width)), 2, 4 * resolution))
