"""A ball cut into more and more elements: cost of an element, in the sand and above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
from measure import Case, Group

import mjgranular
from mjgranular import Plane, Sand

_BALL = """
<mujoco>
  <option timestep="1e-5" gravity="0 0 -9.81"/>
  <worldbody><body><freejoint/><geom type="sphere" size="0.1"/></body></worldbody>
</mujoco>
"""
_RESOLUTIONS = (2, 4, 8, 16, 32, 64, 105)  # 8 to 14 000 elements
_WORK = 2e5  # elements times steps per run
_MEDIUM = "quikrete_medium"


def _ball(scheme: str, resolution: int | None, height: float) -> Case:
    """Return a ball at 1 m/s, `height` below the surface; one element without a resolution."""
    spec = mujoco.MjSpec.from_string(_BALL)
    bare = spec.compile()
    law = mjgranular.DepthVelocityLaw(stiffness=100.0, quadratic=1.0)
    arguments: dict[str, Any] = {"law": law}
    if resolution is not None:
        arguments = {"law": "rft3d", "resolution": resolution}
    arguments |= {"medium": _MEDIUM, "surface": Plane(height), "scheme": scheme}
    count = len(Sand(bare, **arguments).elements)
    mjgranular.add_sand(spec, **arguments)
    model = spec.compile()
    data = mujoco.MjData(model)
    steps = max(10, min(2000, round(_WORK / count)))

    def begin() -> None:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = 0.1, 0.2, -1.0, 0.0, 0.3, 0.0

    word = "element" if count == 1 else "elements"
    return Case(
        f"{count} {word}",
        begin,
        lambda: mujoco.mj_step(model, data, steps),
        steps,
        {"elements": count},
    )


def _bare() -> Case:
    model = mujoco.MjModel.from_xml_string(_BALL)
    data = mujoco.MjData(model)
    return Case(
        "mj_step without sand",
        lambda: mujoco.mj_resetData(model, data),
        lambda: mujoco.mj_step(model, data, 2000),
        2000,
        {"elements": 0},
    )


def _cases(scheme: str, height: float) -> Sequence[Case]:
    sizes = (None, *_RESOLUTIONS)
    return [_bare(), *(_ball(scheme, resolution, height) for resolution in sizes)]


GROUPS = tuple(
    Group(
        f"Elements {where}, {scheme}",
        f"A ball of 0.2 m at 1 m/s {note}; one element is `depth_velocity`, more are `rft3d`.",
        lambda scheme=scheme, height=height: _cases(scheme, height),
    )
    for where, note, height in (
        ("in the sand", "deep in the sand, half of its skin leading", 0.5),
        ("above the sand", "above the sand: what looking costs", -0.5),
    )
    for scheme in ("explicit", "implicit")
)
