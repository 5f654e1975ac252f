"""Gymnasium's robots on sand, compared with the same on their rigid floor."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from measure import Case, Group

import mjgranular
from mjgranular import Sand

_ROBOTS = {
    "Hopper": ("hopper.xml", 4),
    "HalfCheetah": ("half_cheetah.xml", 5),
    "Walker2d": ("walker2d_v5.xml", 4),
    "Ant": ("ant.xml", 5),
    "Humanoid": ("humanoid.xml", 5),
}
"""File, and number of steps per action."""

_ACTIONS = 100
_SETTLED = 2000  # steps without controls before a robot counts as settled
_SANDS: dict[str, dict[str, Any]] = {
    "sand, default resolution": {},
    "sand, resolution 4": {"resolution": 4},
}


def _assets() -> Path | None:
    found = find_spec("gymnasium")
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "envs" / "mujoco" / "assets"


def _spec(file: str) -> mujoco.MjSpec:
    folder = _assets()
    assert folder is not None
    spec = mujoco.MjSpec.from_file(str(folder / file))
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        # The implicit scheme does not support it; the model on the floor gets the same integrator.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "compiler attribute 'settotalmass'")  # HalfCheetah's
        return spec.compile()


def _sandy(file: str, **options: Any) -> tuple[mujoco.MjModel, int]:
    """Return the robot with sand in place of its floor, and the number of elements."""
    spec = _spec(file)
    spec.geom("floor").contype = spec.geom("floor").conaffinity = 0
    arguments = {"medium": "quikrete_medium", "scheme": "implicit", **options}
    count = len(Sand(_compiled(spec), **arguments).elements)
    mjgranular.add_sand(spec, **arguments)
    return _compiled(spec), count


def _acting(name: str, model: mujoco.MjModel, skip: int, facts: dict[str, Any]) -> Case:
    """Return a case with random controls from the start."""
    data = mujoco.MjData(model)
    low, high = model.actuator_ctrlrange.T
    actions = np.random.default_rng(0).uniform(low, high, (_ACTIONS, model.nu))

    def run() -> None:
        for action in actions:
            data.ctrl[:] = action
            mujoco.mj_step(model, data, skip)

    return Case(name, lambda: mujoco.mj_resetData(model, data), run, _ACTIONS * skip, facts)


def _settled(name: str, model: mujoco.MjModel, skip: int, facts: dict[str, Any]) -> Case:
    """Return a case without controls, from rest."""
    data, rest = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_step(model, rest, _SETTLED)
    return Case(
        name,
        lambda: mujoco.mj_copyData(data, model, rest),
        lambda: mujoco.mj_step(model, data, _ACTIONS * skip),
        _ACTIONS * skip,
        facts,
    )


def _cases(robot: str, make: Any) -> Sequence[Case]:
    file, skip = _ROBOTS[robot]
    cases = [make("rigid floor", _compiled(_spec(file)), skip, {"elements": 0})]
    for name, options in _SANDS.items():
        model, count = _sandy(file, **options)
        cases.append(make(name, model, skip, {"elements": count}))
    return cases


GROUPS = tuple(
    Group(
        f"{robot}, {how}",
        "Gymnasium's model as it is, with sand (the default law, implicit, plugin) in place of its "
        f"floor, {note}. Models that use RK4 take `implicitfast`, on the floor too.",
        lambda robot=robot, make=make: _cases(robot, make),
    )
    for robot in _ROBOTS
    for how, note, make in (
        ("random controls", "driven at random", _acting),
        ("settled", "lying still without controls", _settled),
    )
    if _assets() is not None
)
