"""Point feet: made for contacts with a floor, they sink into sand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from mjgranular._util.names import name_of
from mjgranular.errors import PointsWarning, listed, warn_user
from mjgranular.sand.spec import SandSpec
from mjgranular.shape.select import body_name, collides

SHARE = 0.15
"""Radius of a point, at most, in parts of the radius of what is drawn of its body. Chosen: the four
spheres under a humanoid's foot have 0.04; the smallest true foot, a ball at the end of a shin, has
0.2."""


@dataclass(frozen=True)
class Points:
    """A body that meets the sand with points only.

    Attributes:
        body: its id.
        geoms: ids of the points.
        drawn: id of the largest geom that is only drawn.
    """

    body: int
    geoms: tuple[int, ...]
    drawn: int


def find_points(model: mujoco.MjModel, geoms: Sequence[int]) -> list[Points]:
    """Find the bodies that meet the sand only with geoms small compared to what is drawn.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
    """
    members: dict[int, list[int]] = {}
    for geom in geoms:
        members.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    found = []
    for body, mine in members.items():
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        drawn = [g for g in range(first, first + count) if g not in mine and not collides(model, g)]
        if not drawn:
            continue
        largest = max(drawn, key=lambda g: model.geom_rbound[g])
        if max(model.geom_rbound[mine]) < SHARE * model.geom_rbound[largest]:
            found.append(Points(body, tuple(mine), largest))
    return found


def warn_of_points(model: mujoco.MjModel, geoms: Sequence[int], spec: SandSpec) -> None:
    """Warn of bodies that will sink, and say how to choose what is drawn.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        spec: the sand; geoms that it names one by one are taken as intended.
    """
    found = find_points(model, geoms) if spec.geoms is None else []
    if not found:
        return
    size = 2e3 * max(model.geom_rbound[list(points.geoms)].max() for points in found)
    every = ["all"] if spec.bodies is None and spec.groups is None else []
    drawn = [name_of(model, "geom", points.drawn) or points.drawn for points in found]
    warn_user(
        f"{listed(body_name(model, points.body) for points in found)} "
        f"{'meets' if len(found) == 1 else 'meet'} the sand with points only, at most {size:.3g} "
        "mm wide: made for contacts with a floor, they will sink; to have what is drawn in the "
        f"sand too, take geoms={[*every, *drawn]} (--geoms {' '.join(map(str, [*every, *drawn]))})",
        PointsWarning,
    )
