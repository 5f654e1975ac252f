"""Warn of moving parts that the sand ignores or misjudges, and of sensors that ignore the sand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco

from mjgranular._util.names import name_of
from mjgranular.errors import UnfeltWarning, listed, warn_user
from mjgranular.shape.select import body_name, collides, mocap_above, moves


def warn_of_unfelt(model: mujoco.MjModel, geoms: Sequence[int], *, chosen: bool) -> None:
    """Warn of parts of a model that seem to be in the sand but are not.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        chosen: whether the user has selected them, and so excluded others.
    """
    for told in [*_hung(model, geoms), *_numb(model, geoms), *(() if chosen else _left_out(model))]:
        warn_user(told, UnfeltWarning)


def _left_out(model: mujoco.MjModel) -> Iterator[str]:
    for flex in range(model.nflex):
        if any(moves(model, body) for body in _bodies_of(model, flex)):
            yield (
                f"the sand does not act on flex {name_of(model, 'flex', flex) or flex!r}: it feels "
                "geoms of rigid bodies alone; name with bodies=[...] those that meet it"
            )
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        mocap = mocap_above(model, body)
        if mocap is not None and collides(model, geom) and not moves(model, body):
            yield (
                f"the sand does not act on mocap body {body_name(model, mocap)}, to which MuJoCo "
                "gives no velocity: put its geoms on a free body and <weld> that to it, or name "
                "with bodies=[...] those that meet the sand"
            )
            return


def _hung(model: mujoco.MjModel, geoms: Sequence[int]) -> Iterator[str]:
    """Describe bodies in the sand that move with a mocap body, whose motion has no velocity."""
    for body in sorted({int(model.geom_bodyid[geom]) for geom in geoms}):
        mocap = mocap_above(model, body)
        if mocap is not None:
            yield (
                f"body {body_name(model, body)} hangs on mocap body {body_name(model, mocap)}, to "
                "which MuJoCo gives no velocity: the sand feels the motion of the joints between "
                "them alone; <weld> a free body to the mocap body, and hang it on that"
            )
            return


def _numb(model: mujoco.MjModel, geoms: Sequence[int]) -> Iterator[str]:
    """Describe touch sensors that do not measure the sand that their bodies are in."""
    bodies = {int(model.geom_bodyid[geom]) for geom in geoms}
    site = model.sensor_objtype == mujoco.mjtObj.mjOBJ_SITE
    ours = model.sensor_objid[site & (model.sensor_type == mujoco.mjtSensor.mjSENS_PLUGIN)]
    numb = [
        name_of(model, "sensor", sensor) or f"number {sensor}"
        for sensor in (model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH).nonzero()[0]
        if int(model.site_bodyid[model.sensor_objid[sensor]]) in bodies
        and model.sensor_objid[sensor] not in ours
    ]
    if numb:
        one = len(numb) == 1
        yield (
            f"touch {'sensor' if one else 'sensors'} {listed(numb)} {'reads' if one else 'read'} "
            "contacts alone, and nothing of the sand: the sensor mjgranular.sensor with the "
            "measure touch does, inside mj_step, and Sand.report"
        )


def _bodies_of(model: mujoco.MjModel, flex: int) -> set[int]:
    """Return the bodies of the vertices or nodes of a flex."""
    bodies = set()
    for part in ("vert", "node"):
        first = int(getattr(model, f"flex_{part}adr")[flex])
        count = int(getattr(model, f"flex_{part}num")[flex])
        bodies.update(getattr(model, f"flex_{part}bodyid")[first : first + count].tolist())
    return {body for body in bodies if body > 0}
