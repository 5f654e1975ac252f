"""Divide the surface of a shape into facets, in the shape's own frame.

A curved surface is sampled finely on a grid of two parameters and grouped into coarser patches. A
patch keeps the properties of the curved surface: area, centroid, mean normal, and to first order
the variation of points and normals over it. So a patch can be partly immersed, or partly leading.
Every division has the symmetries of its shape.

The number of patches needed for a given error was measured (docs/shapes.md).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

Skin = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps u, v in [0, 1], each (n, m), to points [m], shape (n, m, 3); du x dv points outward."""

_FINE = 8  # cells per patch along each parameter; chosen, not measured
# An ellipsoid is divided between equal shares of a stretched sphere's surface (0) and equal shares
# of the normals (1). Measured: below 0.1 the rim of a lens, above 0.4 its sides are too coarse.
_TURNING = 0.2
_FLAT = 1e-9  # change of a normal that is rounding; chosen
_NEAR = 0.8  # of the corners: where there is a cell, and no two that are as near
CORNERS = np.array([(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)])
"""Of the middle half of a facet, in half edges."""
_WHEEL = 64  # least number of patches around a wheel; measured (docs/shapes.md)


@dataclass(frozen=True)
class Facets:
    """Facets of a surface.

    A point of a facet is `point + s edges[0] + t edges[1]`, with s and t from -1 to 1, and the
    normal there is along `normal + s spread[0] + t spread[1]`. The parallelogram has the centroid
    and the second moments of the facet; its area may differ. `skin` is a sample, a point
    of each quarter: near `CORNERS`, or there if the facet is flat.
    """

    points: np.ndarray  # centroids [m], shape (n, 3)
    normals: np.ndarray  # unit, outward, shape (n, 3)
    areas: np.ndarray  # [m^2], shape (n,)
    edges: np.ndarray  # half edges [m], shape (n, 2, 3)
    spread: np.ndarray  # half differences of the unit normal along them, shape (n, 2, 3)
    skin: np.ndarray  # points [m] of the skin and unit normals there, shape (n, 4, 2, 3)

    def __len__(self) -> int:
        return len(self.areas)


class Cells(NamedTuple):
    """Small pieces of a surface, and the patches they are grouped into."""

    points: np.ndarray  # on the surface [m], shape (n, 3)
    vectors: np.ndarray  # area times outward normal [m^2], shape (n, 3)
    places: np.ndarray  # two coordinates of a cell in its patch, -1 to 1, shape (n, 2)
    patches: np.ndarray  # index of the patch of each, from 0, shape (n,)

    def only(self, chosen: np.ndarray) -> "Cells":
        """Return those selected by a mask, shape (n,), in the same patches."""
        return Cells(*(values[chosen] for values in self))

    def gathered(self) -> Facets:
        """Return one facet for each patch that has an area."""
        areas = np.linalg.norm(self.vectors, axis=1)
        there = areas > 0  # a capsule's side may have zero length, a triangle zero width
        if not there.all():
            return self.only(there).gathered()
        _, patch, count = np.unique(self.patches, return_inverse=True, return_counts=True)
        first = np.concatenate([[0], np.cumsum(count)])[:-1]

        def total(values: np.ndarray) -> np.ndarray:
            """Sum over patches, whose cells are consecutive."""
            return np.add.reduceat(values, first) if len(first) else values

        def mean(values: np.ndarray) -> np.ndarray:
            return total((areas * values.T).T) / total(areas).reshape(-1, *[1] * (values.ndim - 1))

        points, normals = mean(self.points), total(self.vectors)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        # Slopes by least squares in each coordinate, times half the width of a flat patch whose
        # cells would vary as much: 3 times the variance, including that within a cell.
        away = self.places - mean(self.places)[patch]
        variance = mean(away**2)
        seen = variance > 1e-9  # a patch with a single visible row of cells has no slope
        per_width = np.sqrt(3 * variance + _FINE**-2) / np.where(seen, variance, np.inf)

        def slopes(values: np.ndarray) -> np.ndarray:
            return mean(away[:, :, None] * values[:, None, :]) * per_width[:, :, None]

        around = self.vectors / areas[:, None]
        edges, spread = slopes(self.points), slopes(around)
        skin = at_corners(points, normals, edges)
        curved = np.abs(spread).max(axis=(1, 2)) > _FLAT
        for k, corner in enumerate(_NEAR * CORNERS):
            away = ((self.places - corner) ** 2).sum(axis=1)
            rows = np.argsort(patch + away / 8, kind="stable")[first][curved]
            skin[curved, k, 0], skin[curved, k, 1] = self.points[rows], around[rows]
        return Facets(points, normals, total(areas), edges, spread, skin)


def at_corners(points: np.ndarray, normals: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return `Facets.skin` of flat facets."""
    corners = points[:, None] + CORNERS @ edges
    return np.stack([corners, np.broadcast_to(normals[:, None], corners.shape)], axis=2)


def triangles(corners: np.ndarray) -> Cells:
    """Return triangles [m], counter-clockwise seen from outside: each is one cell and one patch."""
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(corners)
    return Cells(corners.mean(axis=1), doubled / 2, np.zeros((count, 2)), np.arange(count))


def patches(skin: Skin, along: int, around: int) -> Cells:
    """Return cells of a surface divided into `along` patches over u and `around` over v."""
    n, m = along * _FINE, around * _FINE
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    grid = skin(u, v)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    middles = skin((i + 0.5) / n, (j + 0.5) / m)
    vectors = 0.5 * np.cross(c - a, d - b)  # exact for a flat cell
    places = np.stack([i % _FINE, j % _FINE], axis=-1) * (2 / _FINE) - (1 - 1 / _FINE)
    patch = (i // _FINE) * around + j // _FINE
    order = np.argsort(patch, axis=None, kind="stable")  # the cells of a patch are consecutive
    cells = (middles.reshape(-1, 3), vectors.reshape(-1, 3), places.reshape(-1, 2), patch.ravel())
    return Cells(*(values[order] for values in cells))


def rings(skin: Skin, counts: Sequence[int], turned: Sequence[float] | None = None) -> Cells:
    """Return cells of a surface, closed in v, divided over u into rings of equal width.

    `counts` is the number of patches around each ring, `turned` its rotation in patches.
    """

    def ring(k: int, turn: float, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return skin((k + u) / len(counts), v + turn)

    both = zip(counts, turned or [0.0] * len(counts), strict=True)
    parts = [patches(partial(ring, k, turn / n), 1, n) for k, (n, turn) in enumerate(both)]
    return joined(parts)


def joined(parts: Sequence[Cells]) -> Cells:
    """Concatenate all cells, and renumber the patches."""
    counts = [part.patches.max(initial=-1) + 1 for part in parts]
    first = np.cumsum([0, *counts[:-1]])
    apart = [part._replace(patches=part.patches + k) for part, k in zip(parts, first, strict=True)]
    return Cells(*map(np.concatenate, zip(*apart, strict=True)))


def _revolved(profile: Callable[[np.ndarray], Any], up: float = 1.0) -> Skin:
    """Return the skin of a surface of revolution about z, from its radius and height over u.

    With `up` -1 the turn is reversed: the same profile, upside down, faces down.
    """

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        radius, height = profile(u)
        turn = 2 * math.pi * v * up
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=-1)

    return skin


def ellipsoid(radii: tuple[float, float, float], resolution: int) -> Cells:
    """Return an ellipsoid: `resolution` rings from pole to pole, twice that around the equator."""
    size = np.array(radii)
    ball = _revolved(lambda u: (np.sin(math.pi * u), np.cos(math.pi * u)))

    def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        along = ball(u, v) * size**_TURNING
        return along / np.linalg.norm(along, axis=-1)[..., None] * size

    # Counted from the nearer pole, so that rounding is symmetric.
    ring = [min(k, resolution - 1 - k) for k in range(resolution)]
    polar = [math.pi * (k + 0.5) / resolution for k in ring]
    return rings(skin, [_around(2 * resolution * math.sin(angle)) for angle in polar])


def tube(radius: float, half: float, rows: int, around: int) -> Cells:
    """Return the side of a cylinder about z; an odd number of rows is laid like bricks.

    Bricks sample twice as many normals; an even number of such rows were not symmetric.
    """
    skin = _revolved(lambda u: (radius, half * (1 - 2 * u)))
    return rings(skin, [around] * rows, [0.5 * (rows % 2) * (row % 2) for row in range(rows)])


def disc(radius: float, height: float, count: int) -> Cells:
    """Return a disc at that height, facing away from z = 0: `count` rings of 6, 12, ... patches."""
    skin = _revolved(lambda u: (radius * u, np.full_like(u, height)), math.copysign(1.0, height))
    return rings(skin, [6 * (k + 1) for k in range(count)])


def cap(radius: float, height: float, count: int) -> Cells:
    """Return a half sphere, its rim at that height, facing away from z = 0, in `count` rings."""
    up = math.copysign(1.0, height)

    def profile(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        polar = math.pi / 2 * u
        return radius * np.sin(polar), height + up * radius * np.cos(polar)

    polar = [math.pi / 2 * (k + 0.5) / count for k in range(count)]
    return rings(_revolved(profile, up), [_around(4 * count * math.sin(angle)) for angle in polar])


def cylinder(radius: float, half: float, resolution: int, spins: bool = False) -> Cells:
    """Return a cylinder about z with flat ends; `2 * resolution` patches around.

    A wheel, which spins about z or is up to twice as long as thick, has four times as many, since
    its facets turn along their own skin, and two rows or more: with one it falls over.
    """
    around, rows = 2 * resolution, _rows(radius, half, resolution)
    if spins or half <= 2 * radius:
        around, rows = max(4 * around, _WHEEL), max(2, rows)
    side = tube(radius, half, rows, around)
    count = max(1, round(resolution / 6))
    return joined([side, disc(radius, half, count), disc(radius, -half, count)])


def capsule(radius: float, half: float, resolution: int) -> Cells:
    """Return a capsule about z; `2 * resolution` patches around its side."""
    side = tube(radius, half, _rows(radius, half, resolution), 2 * resolution)
    # As fine as a sphere if there is no side; coarser the smaller the ends' share of the surface.
    count = max(1, round(resolution * (0.3 + 0.2 * radius / (radius + half))))
    return joined([side, cap(radius, half, count), cap(radius, -half, count)])


def box(halves: tuple[float, float, float], resolution: int) -> Cells:
    """Return a box; a third of `resolution` patches along its longest edge, others in proportion.

    A flat patch, fully or partly immersed, is exact unless it turns: rotation needs several.
    """
    _, middle, longest = sorted(halves)
    # The small number prevents rounding from adding a patch to a third of a multiple of three.
    counts = [max(1, math.ceil(resolution / 3 * half / longest - 1e-9)) for half in halves]
    along = halves.index(longest)
    counts[along] = max(counts[along], _pieces(longest, middle, resolution))

    def face(axis: int, side: float) -> Cells:
        first, second = (axis + 1) % 3, (axis + 2) % 3

        def skin(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            points = np.empty((*u.shape, 3))
            points[..., axis] = side * halves[axis]
            points[..., first] = side * halves[first] * (2 * u - 1)
            points[..., second] = halves[second] * (2 * v - 1)
            return points

        return patches(skin, counts[first], counts[second])

    return joined([face(axis, side) for axis in range(3) for side in (1.0, -1.0)])


def _rows(radius: float, half: float, resolution: int) -> int:
    """Return the rows of patches along a tube: odd, about a third of the resolution if slender."""
    rows = 1 + 2 * round(resolution / 6 * half / (half + radius))
    return max(rows, _pieces(half, radius, resolution) // 2 * 2 + 1)


def _pieces(half: float, radius: float, resolution: int) -> int:
    """Return the pieces of a rod, at most one and a half widths long; at most `resolution`.

    With two widths a stake holds 15 % less than with fine facets, and with these 4 %.
    """
    return min(resolution, math.ceil(half / (1.5 * radius) - 1e-9))


def _around(count: float) -> int:
    """Return the patches around a ring: in fours, so that none crosses a plane of symmetry."""
    return max(4, 4 * round(count / 4))
