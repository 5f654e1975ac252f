"""Intruders as spheres that LAMMPS can move: one sphere, or a rigid cluster."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from grains import Bed

_SHELL = 0.0025  # diameter of the spheres of plates and feet [m]; spaced by half of it
_RIPPLE = 0.1  # spacing of a rod's spheres, in diameters: a ripple of 0.25 %
_CLEAR = 2e-5  # gap between an intruder and the first grain at the start [m]


@dataclass(frozen=True)
class Intruder:
    """A rigid body made of spheres.

    Attributes:
        body: with the keys of `runs.yaml`: shape and sizes [m].
        centers: centers of its spheres relative to the body's center [m], shape (n, 3).
        diameters: diameters of its spheres [m], shape (n,).
        inertia: inertia about the center, xx, yy, zz, xy, xz, yz, per unit mass [m^2].
        angle: angle of the axis from the vertical, in the x-z plane, toward +x at the top [rad].
        sides: sides of a plate, along x, y and z [m].
        places: centers of the plates of a rigid row, the leading one first [m].
    """

    body: dict[str, Any]
    centers: np.ndarray
    diameters: np.ndarray
    inertia: tuple[float, ...] = (0.0,) * 6
    angle: float = 0.0
    sides: tuple[float, ...] = ()
    places: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),)

    @property
    def lowest(self) -> float:
        """Height of its lowest point relative to its center [m]."""
        return float((self.centers[:, 2] - self.diameters / 2).min())

    def start_over(self, bed: Bed) -> np.ndarray:
        """Return the body's center above the bed's middle, just clear of the first grain [m]."""
        middle = np.array([bed.lengths[0] / 2, bed.lengths[1] / 2, 0.0])
        high = bed.centers[bed.centers[:, 2] > bed.surface - 4 * bed.grains.diameter]
        wide = bed.diameters[bed.centers[:, 2] > bed.surface - 4 * bed.grains.diameter]
        height = -math.inf
        for center, diameter in zip(self.centers, self.diameters, strict=True):
            apart = high[:, :2] - middle[:2] - center[:2]
            apart -= np.round(apart / bed.lengths) * bed.lengths  # the nearest image
            reach = ((wide + diameter) / 2) ** 2 - (apart**2).sum(axis=1)
            met = reach > 0
            if met.any():
                touch = high[met, 2] + np.sqrt(reach[met]) - center[2]
                height = max(height, float(touch.max()))
        return middle + np.array([0.0, 0.0, height + _CLEAR])


def sphere(diameter: float) -> Intruder:
    """Return one sphere."""
    body = {"shape": "sphere", "diameter": diameter}
    return Intruder(body, np.zeros((1, 3)), np.array([diameter]))


def capsule(length: float, diameter: float, angle: float) -> Intruder:
    """Return a rod with round ends, with the inertia of a uniform cylinder.

    Args:
        length: overall length [m].
        diameter: [m].
        angle: angle of its axis from the vertical [rad], with the upper end toward +x.
    """
    half = (length - diameter) / 2
    count = 1 + math.ceil(2 * half / (_RIPPLE * diameter))
    along = np.linspace(-half, half, count)
    axis = np.array([math.sin(angle), 0.0, math.cos(angle)])
    across = (3 * (diameter / 2) ** 2 + length**2) / 12
    axial = (diameter / 2) ** 2 / 2
    tensor = across * (np.eye(3) - np.outer(axis, axis)) + axial * np.outer(axis, axis)
    body = {"shape": "capsule", "length": length, "diameter": diameter}
    return Intruder(body, along[:, None] * axis, np.full(count, diameter), _six(tensor), angle)


def plate(
    length: float,
    thickness: float,
    *,
    upright: bool = False,
    tilt: float = 0.0,
    count: int = 1,
    gap: float = 0.0,
) -> Intruder:
    """Return a square plate, a flat foot or a row of them, as shells of spheres.

    Args:
        length: side of the plate [m].
        thickness: [m].
        upright: whether its normal is along x, as for a drag.
        tilt: of the normal of a level one from the vertical, toward +x at the top [rad].
        count: number of upright plates, one behind another along -x; the inertia is that of one.
        gap: gap between their faces [m].
    """
    sides = np.array([thickness, length, length] if upright else [length, length, thickness])
    inner = sides - _SHELL
    counts = np.maximum(2, 1 + np.round(inner / (_SHELL / 2)).astype(int))
    axes = [np.linspace(-side / 2, side / 2, n) for side, n in zip(inner, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = (np.abs(np.abs(grid) - inner / 2) < 1e-9).any(axis=1)
    places = np.arange(count)[:, None] * np.array([-(thickness + gap), 0.0, 0.0])
    turn = np.array(
        [[math.cos(tilt), 0, math.sin(tilt)], [0, 1, 0], [-math.sin(tilt), 0, math.cos(tilt)]]
    )
    centers = (places[:, None] + grid[outside]).reshape(-1, 3) @ turn.T
    moments = [(sides[(i + 1) % 3] ** 2 + sides[(i + 2) % 3] ** 2) / 12 for i in range(3)]
    body = {"shape": "plate", "length": length, "diameter": thickness}
    return Intruder(
        body,
        centers,
        np.full(len(centers), _SHELL),
        _six(np.diag(moments)),
        angle=math.pi / 2 if upright else tilt,
        sides=tuple(sides),
        places=tuple(tuple(place) for place in places),
    )


def _six(tensor: np.ndarray) -> tuple[float, ...]:
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tuple(float(tensor[i, j]) for i, j in pairs)
