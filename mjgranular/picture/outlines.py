"""Outlines of elements: the polygons of a figure."""

from __future__ import annotations

import math

import numpy as np

from mjgranular.picture.shown import Shown

AROUND = 24
"""Number of corners of a drawn circle."""
_LEAST_SHARE = 0.25  # least area of the edges' parallelogram, relative to the facet's; else a disc


def polygons_of(shown: Shown) -> tuple[np.ndarray, np.ndarray]:
    """Return polygons of elements in the world frame, and the element that each belongs to."""
    e, n = shown.elements, np.arange(len(shown.elements))
    if shown.kind == "facets":
        return shown.place(facet_corners(e)), n
    if shown.kind == "rods":
        rims = shown.place(_rod_rims(e)).reshape(-1, 2, AROUND, 3)
        after = np.roll(rims, -1, axis=2)
        sides = np.stack([rims[:, 0], after[:, 0], after[:, 1], rims[:, 1]], axis=2)
        polygons = [padded(sides.reshape(-1, 4, 3), AROUND), rims.reshape(-1, AROUND, 3)]
        return np.concatenate(polygons), np.concatenate([n.repeat(AROUND), n.repeat(2)])
    grids = shown.place(_blob_points(e)).reshape(len(e), -1, AROUND, 3)
    after = np.roll(grids, -1, axis=2)
    quads = np.stack([grids[:, :-1], grids[:, 1:], after[:, 1:], after[:, :-1]], axis=3)
    sides = padded(quads.reshape(-1, 4, 3), AROUND)
    polygons = np.concatenate([sides, grids[:, 0], grids[:, -1]])
    owners = np.concatenate([n.repeat(len(sides) // len(e)), n, n])
    # Directions with the same outermost point, as at a corner, have empty polygons between them.
    area = np.linalg.norm(area_vectors(polygons), axis=1)
    seen = area > 1e-6 * shown.sizes[owners] ** 2
    return polygons[seen], owners[seen]


def padded(polygons: np.ndarray, corners: int) -> np.ndarray:
    """Repeat the last corners of polygons until each has `corners` corners."""
    last = np.repeat(polygons[:, -1:], corners - polygons.shape[1], axis=1)
    return np.concatenate([polygons, last], axis=1)


def facet_corners(facets: np.ndarray) -> np.ndarray:
    """Return the corners of facets in body frames, shape (n, k, 3), with the true area."""
    wide, edges = half_edges(facets)
    around = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ edges
    if not wide.all():
        radius = np.sqrt(2 * facets["area"] / (AROUND * math.sin(2 * math.pi / AROUND)))
        discs = radius[:, None, None] * _circles(facets["normal"])
        discs[wide] = padded(around, AROUND)
        around = discs
    return facets["point"][:, None] + around


def half_edges(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which facets are parallelograms, shape (n,), and their half edges, shape (m, 2, 3).

    The edges are scaled to the facets' areas. A single triangle has no edges, and those of a patch
    hidden except for a strip are tiny: both are drawn as discs.
    """
    if "edges" not in (facets.dtype.names or ()):
        return np.zeros(len(facets), bool), np.zeros((0, 2, 3))
    edges = facets["edges"]
    area = 4 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    wide = area > _LEAST_SHARE * facets["area"]
    return wide, edges[wide] * np.sqrt(facets["area"][wide] / area[wide])[:, None, None]


def _rod_rims(rods: np.ndarray) -> np.ndarray:
    """Return the corners of the two ends of rods in body frames, shape (n, 2 * AROUND, 3)."""
    ring = (rods["width"] / 2)[:, None, None] * _circles(rods["axis"])
    along = (rods["half_length"][:, None] * rods["axis"])[:, None]
    return rods["center"][:, None] + np.concatenate([ring - along, ring + along], axis=1)


def _circles(axes: np.ndarray) -> np.ndarray:
    """Return points on circles of radius 1 about axes, shape (n, AROUND, 3)."""
    turn = 2 * math.pi * np.arange(AROUND) / AROUND
    return np.stack([np.cos(turn), np.sin(turn)], axis=1) @ frames_of(axes)[:, :, :2].mT


def _blob_points(blobs: np.ndarray) -> np.ndarray:
    """Return points of blobs in body frames, shape (n, (AROUND / 2) * AROUND, 3).

    They are the outermost points in directions of a grid of latitude and longitude, none of which
    lies in a plane of symmetry, where a box would have more than one.
    """
    polar = math.pi * (np.arange(AROUND // 2) + 0.5) / (AROUND // 2)
    turn = 2 * math.pi * (np.arange(AROUND) + 0.5) / AROUND
    polar, turn = np.meshgrid(polar, turn, indexing="ij")
    ways = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1
    ).reshape(1, -1, 3)
    radii, halves = blobs["radii"][:, None], blobs["halves"][:, None]
    length = np.linalg.norm(radii * ways, axis=2, keepdims=True)
    points = radii**2 * ways / np.where(length > 0, length, 1.0) + halves * np.sign(ways)
    flat = ways[..., :2] / np.linalg.norm(ways[..., :2], axis=2, keepdims=True)
    points[..., :2] += blobs["disc"][:, None, None] * flat
    turned = np.einsum("nij,nkj->nki", blobs["axes"].reshape(-1, 3, 3), points)
    return blobs["center"][:, None] + turned


def frames_of(axes: np.ndarray) -> np.ndarray:
    """Return right-handed frames in columns with given unit vectors as z, shape (n, 3, 3)."""
    first = np.cross(axes, np.eye(3)[np.argmin(np.abs(axes), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first), axes], axis=2)


def area_vectors(polygons: np.ndarray) -> np.ndarray:
    """Return area times normal of polygons with the same number of corners, shape (n, 3)."""
    arms = polygons - polygons[:, :1]
    return np.cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1) / 2
