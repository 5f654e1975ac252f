"""The triangles of a mesh, and few patches that they are grouped into, each a facet.

Meshes of machines have tens of thousands of triangles, most of them far smaller than the sand can
resolve. Patches are found top-down: all triangles are one patch, and the patches with the largest
variation of position and direction are split in two until they are fine enough or as many as
allowed. So flat parts form large patches, and the two sides of a plate are split first.

A patch keeps the sum of the area vectors (area times outward normal) of its triangles, so a closed
surface stays closed; centroid and second moments of their area; and the slope of their normals.
Where the surface is round, the normal turns to that of the round surface at the centroid.
"""

import math

import numpy as np

from mjgranular.shape.sizes import rod_length
from mjgranular.shape.tessellation import Facets, at_corners

# Chosen by measurement (docs/shapes.md): changing one of them by a factor of two has little effect.
_MOST = 2.0  # patches of a mesh, times the square of the resolution
_FINE = 4.0  # variation that is fine enough, over the square of the resolution
_PLACE = 5.0  # weight of positions in a mesh of size 1, relative to that of unit normals
_PIECE = 1.5  # longest edge of a triangle in a mesh of size 1, over the resolution
# Least size of a mesh relative to its extent, so that a spike does not make many pieces.
_THORN = 0.1
_ROUND = 0.25  # each pass splits all patches that vary by this share of the worst, at least
_FLAT = 1e-6  # patches narrower than this share of their mesh have zero width; chosen: rounding
# Of one flat face: normals within 10 degrees, and centers within a twentieth of the width; chosen.
_PARALLEL, _COPLANAR = 0.985, 0.05
_CURVED = math.sqrt(1 - _PARALLEL**2)  # such a fraction of a cylinder's projection is no flat face
# Triangles at a smaller angle are of a round surface, at a larger one not; chosen.
_SMOOTH, _SHARP = math.cos(math.radians(30)), math.cos(math.radians(45))
_ENOUGH = 2000  # maximum number of facets in the comparison; chosen
# Where a patch is sampled, as shares of its area: not on the edges of equal triangles.
_QUARTERS = (0.13, 0.37, 0.63, 0.87)
_CANCELLED = 1e-6  # relative size of the summed area vectors below which a patch has no direction


def pieces(corners: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide triangles until no edge is longer than patches are wide; area vectors stay.

    Corners of triangles are of shape (n, 3, 3) [m], before and after; the resolution is as of
    `facets_from_model`. Returns as well the row of the triangle that each is a piece of.
    """
    reach = np.ptp(corners.reshape(-1, 3), axis=0).max()
    longest = _PIECE / resolution * max(_size(corners), _THORN * reach)
    done, parents = [], np.arange(len(corners))
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = edges.max(axis=1) > longest
        done.append((corners[~large], parents[~large]))
        row, first = np.arange(large.sum()), edges[large].argmax(axis=1)
        a, b, c = (corners[large][row, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners, parents = np.concatenate(halves), np.tile(parents[large], 2)
    corners, parents = map(np.concatenate, zip(*done, strict=True))
    return corners, parents


def bends(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how much a round surface's normal differs from each triangle's, linear in position.

    At the middle of an edge it is the mean of both triangles', less so if they differ by more than
    30 degrees, and not by more than 45. That is slopes [1/m] of shape (n, 3, 3), the normal's
    components first, times the position, plus an offset of shape (n, 3); for vertices [m] and their
    faces.
    """
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    vectors = np.cross(edges[:, 0], edges[:, 1])
    square = np.maximum(np.einsum("ni,ni->n", vectors, vectors), np.finfo(float).tiny)
    normals = vectors / np.sqrt(square)[:, None]
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    ends = np.sort(np.stack([same[faces], same[np.roll(faces, -1, axis=1)]], axis=2), axis=2)
    _, edge, count = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    edge, own = edge.ravel(), np.repeat(normals, 3, axis=0)
    both = np.stack([np.bincount(edge, column) for column in own.T], axis=1)[edge]
    share = (np.einsum("ni,ni->n", own, both - own) - _SHARP) / (_SMOOTH - _SHARP)
    share = np.where(count[edge] == 2, np.clip(share, 0, 1), 0.0)
    smooth, turned = share > 0, np.zeros((len(own), 3))
    turned[smooth] = both[smooth] / np.linalg.norm(both[smooth], axis=1)[:, None] - own[smooth]
    turned *= share[:, None]
    # 1 at the middle of an edge, and 0 at the middles of the others.
    slopes = 2.0 * np.cross(edges, vectors[:, None]) / square[:, None, None]
    turned = turned.reshape(-1, 3, 3)
    bends = np.einsum("nki,nkj->nij", turned, slopes)
    return bends, turned.mean(axis=1) - np.einsum("nij,nj->ni", bends, corners.mean(axis=1))


def gathered(
    corners: np.ndarray, resolution: int, bends: np.ndarray, offsets: np.ndarray
) -> tuple[Facets, np.ndarray, np.ndarray]:
    """Group triangles into patches, at most twice the square of the resolution.

    Their corners, counter-clockwise seen from outside [m], are of shape (n, 3, 3); `bends`, with
    offsets, are of the whole triangles that they are pieces of. Returns as well what the bends add
    to spread and normals if the surface is round, shapes (n, 2, 3) and (n, 3).
    """
    there = _areas(corners)[1] > 0
    corners, bends, offsets = corners[there], bends[there], offsets[there]
    vectors, areas = _areas(corners)
    if not len(corners):
        shapes = ((3,), (3,), (), (2, 3), (2, 3), (4, 2, 3), (2, 3), (3,))
        *facets, bent, leans = (np.zeros((0, *shape)) for shape in shapes)
        return Facets(*facets), bent, leans
    size, points, normals = _size(corners), corners.mean(axis=1), vectors / areas[:, None]
    places = np.concatenate([np.sqrt(_PLACE) / size * points, normals], axis=1)
    patch, count = _parted(places, areas, resolution)

    def total(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(len(values), -1).T
        sums = [np.bincount(patch, column, count) for column in flat]
        return np.stack(sums, axis=-1).reshape(count, *values.shape[1:])

    area, whole = total(areas), total(vectors)
    middles = total(areas[:, None] * points) / area[:, None]
    away = points - middles[patch]
    # Second moments, with those of each triangle about its own centroid.
    own = np.einsum("nki,nkj->nij", *[corners - points[:, None]] * 2) / 12
    moments = total(areas[:, None, None] * (own + away[:, :, None] * away[:, None]))
    moments /= area[:, None, None]
    turning = total(away[:, :, None] * vectors[:, None]) / area[:, None, None]
    leans = np.einsum("nij,nj->ni", bends, points) + offsets
    bent = np.einsum("ni,nj->nij", away, leans) + own @ bends.swapaxes(1, 2)
    bent = total(areas[:, None, None] * bent) / area[:, None, None]
    leans = total(areas[:, None] * leans) / area[:, None]
    sizes = np.linalg.norm(whole, axis=1)
    there = sizes > _CANCELLED * area
    area, whole, middles, moments, turning, bent, leans, sizes = (
        values[there] for values in (area, whole, middles, moments, turning, bent, leans, sizes)
    )
    normals = whole / sizes[:, None]
    across = np.eye(3) - normals[:, :, None] * normals[:, None]
    variances, axes = np.linalg.eigh(across @ moments @ across)
    variances, axes = variances[:, 1:], axes[:, :, 1:].transpose(0, 2, 1)  # of the two in the plane
    rows = np.flatnonzero(there[patch])
    patch = (np.cumsum(there) - 1)[patch[rows]]
    weights = np.maximum(np.einsum("ni,ni->n", vectors[rows], normals[patch]), 0.0)
    away = points[rows] - middles[patch]
    deep, along = (np.einsum("ni,ni->n", n[patch], away) for n in (normals, axes[:, 1]))
    # The axis points to the longer tail of the patch: a mesh that is turned is sampled alike.
    skew = np.bincount(patch, weights * along**3, len(axes))
    along = np.where(skew < 0, -1.0, 1.0)[patch] * along
    picked = rows[_quarters(patch, weights, deep, along)]
    wide = variances > (_FLAT * size) ** 2
    # Half as wide as a flat patch with these second moments; the normal turns over this distance.
    half = np.sqrt(3 * np.where(wide, variances, 0.0))[:, :, None]
    slope = half * axes / np.where(wide, variances, np.inf)[:, :, None]
    edges = half * axes
    skin = at_corners(middles, normals, edges)
    curved = np.einsum("ni,nij,nj->n", normals, moments, normals) > (_FLAT * size) ** 2
    skin[curved] = np.stack([points[picked], vectors[picked] / areas[picked, None]], 2)[curved]
    return Facets(middles, normals, sizes, edges, slope @ turning, skin), slope @ bent, leans


def single(corners: np.ndarray) -> Facets:
    """Return triangles as facets, each immersed and leading as a whole: no edges, no spread."""
    vectors, areas = _areas(corners)
    corners, vectors, areas = corners[areas > 0], vectors[areas > 0], areas[areas > 0]
    nothing = np.zeros((len(areas), 2, 3))
    points, normals = corners.mean(axis=1), vectors / areas[:, None]
    return Facets(points, normals, areas, nothing, nothing, at_corners(points, normals, nothing))


def flatness(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, width: float
) -> np.ndarray:
    """Return the fraction of a mesh's projection in each facet's direction that is one flat face.

    That is the area of what is nearly in the facet's plane, relative to the area of the whole mesh
    projected in its direction, beyond that of a cylinder: 1 for a face of a box, 0 for a ball.
    """
    # A sample is sufficient for a ratio of areas.
    some = slice(None, None, -(-len(points) // _ENOUGH) or 1)
    found = np.zeros(len(points))
    for first in range(0, len(found), _ENOUGH):
        n, at = normals[first : first + _ENOUGH], points[first : first + _ENOUGH]
        along = n @ normals[some].T
        height = np.einsum("ni,ni->n", n, at)[:, None]
        near = np.abs(n @ points[some].T - height) < _COPLANAR * width
        face = (areas[some] * along * ((along > _PARALLEL) & near)).sum(axis=1)
        shown = 0.5 * (areas[some] * np.abs(along)).sum(axis=1)
        found[first : first + _ENOUGH] = face / np.maximum(shown, face + 1e-300)
    return np.maximum(found - _CURVED, 0.0) / (1.0 - _CURVED)


def _parted(places: np.ndarray, areas: np.ndarray, resolution: int) -> tuple[np.ndarray, int]:
    """Return the patch index of each triangle, from 0, and the number of patches.

    A patch is split at its mean, across the direction in which its triangles vary most. The worst
    patch has the largest variance times area.
    """
    patch, count = np.zeros(len(areas), np.int64), 1
    most = int(_MOST * resolution**2)
    total = areas.sum()
    while count < most:
        weights = np.bincount(patch, areas, count)
        mean = np.stack([np.bincount(patch, areas * x, count) for x in places.T], 1)
        away = places - (mean / weights[:, None])[patch]
        blur = np.bincount(patch, areas * (away**2).sum(axis=1), count)
        blur[blur <= _FINE / resolution**2 * weights] = 0.0
        worst = np.argsort(-blur, kind="stable")[: most - count]
        worst = worst[blur[worst] > max(_ROUND * blur.max(), 1e-15 * total)]
        if not len(worst):
            break
        row = np.full(count, -1)
        row[worst] = np.arange(len(worst))
        mine = np.flatnonzero(row[patch] >= 0)
        row, away = row[patch[mine]], away[mine]
        covariance = np.empty((len(worst), 6, 6))
        for i in range(6):
            for j in range(i + 1):
                sums = np.bincount(row, areas[mine] * away[:, i] * away[:, j], len(worst))
                covariance[:, i, j] = covariance[:, j, i] = sums
        axis = np.linalg.eigh(covariance)[1][:, :, -1]
        beyond = np.einsum("ni,ni->n", away, axis[row]) > 0
        patch[mine[beyond]] = count + row[beyond]
        count += len(worst)
    _, patch = np.unique(patch, return_inverse=True)
    return patch, int(patch.max()) + 1


def _quarters(
    patch: np.ndarray, weights: np.ndarray, deep: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """Return a triangle of each quarter of each patch, shape (n, 4).

    Halves by depth, and quarters along the patch, have equal weight: parts that are behind others
    count by what they show.
    """
    totals = np.bincount(patch, weights)
    before = np.cumsum(totals) - totals
    order = np.lexsort([deep, patch])
    later = np.empty(len(patch), bool)
    passed = np.cumsum(weights[order]) - 0.5 * weights[order]
    later[order] = passed > (before + 0.5 * totals)[patch[order]]
    order = np.lexsort([along, later, patch])
    at = before[:, None] + np.array(_QUARTERS) * totals[:, None]
    return order[np.searchsorted(np.cumsum(weights[order]), at).clip(max=len(order) - 1)]


def _areas(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the area vectors of triangles, and their areas."""
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    return vectors, np.linalg.norm(vectors, axis=1)


def _size(corners: np.ndarray) -> float:
    """Return a size of a mesh [m] that, unlike its box, does not depend on its orientation."""
    areas, points = _areas(corners)[1], corners.mean(axis=1)
    return rod_length(points, areas, corners - points[:, None], 12)
