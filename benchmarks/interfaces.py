"""One link: both interfaces, both schemes, compared with MuJoCo's own forces and with NumPy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
from measure import Case, Group
from numpy_law import NumpySand

import mjgranular
from mjgranular import LinkLaw, Sand
from mjgranular.medium import get_medium
from mjgranular.models import Link

_IMPACT = 1e-6  # time step of the explicit cases [s]: the link always moves in the sand
_STEPS = 5000
_LARGE = 1e-3  # time step of the cases at rest [s]
_SETTLED = 2000  # steps before them


def _model(timestep: float, *, fluid: bool = False, **sand: Any) -> mujoco.MjModel:
    """Return the paper's link; with MuJoCo's ellipsoid fluid, or with sand in the model."""
    spec = Link().spec()
    spec.option.timestep = timestep
    if fluid:
        spec.option.density, spec.option.viscosity = 1.2, 1.8e-5  # air
        spec.geom("link").fluid_ellipsoid = 1.0
    if sand:
        mjgranular.add_sand(spec, **sand)
    return spec.compile()


def _start(model: mujoco.MjModel, data: mujoco.MjData) -> Callable[[], None]:
    """Return a reset to 10 m/s and 45 degrees, with the tip on the surface."""
    key = model.key("impact").id
    return lambda: mujoco.mj_resetDataKeyframe(model, data, key)


def _inside(name: str, model: mujoco.MjModel, steps: int = _STEPS) -> Case:
    """Return a case with all steps in one call of `mj_step`."""
    data = mujoco.MjData(model)
    return Case(name, _start(model, data), lambda: mujoco.mj_step(model, data, steps), steps)


def _looped(name: str, model: mujoco.MjModel, step: Callable[[mujoco.MjData], None]) -> Case:
    """Return a case with a call from Python for each step."""
    data = mujoco.MjData(model)

    def run() -> None:
        for _ in range(_STEPS):
            step(data)

    return Case(name, _start(model, data), run, _STEPS)


def _rested(name: str, model: mujoco.MjModel) -> Case:
    """Return a case like `_inside`, from rest."""
    data, rest = mujoco.MjData(model), mujoco.MjData(model)
    _start(model, rest)()
    mujoco.mj_step(model, rest, _SETTLED)
    return Case(
        name,
        lambda: mujoco.mj_copyData(data, model, rest),
        lambda: mujoco.mj_step(model, data, _STEPS),
        _STEPS,
    )


def _in_the_engine() -> Sequence[Case]:
    explicit: dict[str, Any] = {"scheme": "explicit"}
    implicit: dict[str, Any] = {"scheme": "implicit"}
    spread: dict[str, Any] = {"law": "link_distributed"}
    return [
        _inside("mj_step without sand", _model(_IMPACT)),
        _inside("MuJoCo's ellipsoid fluid", _model(_IMPACT, fluid=True)),
        _inside("link, explicit", _model(_IMPACT, law="link", **explicit)),
        _inside("link, implicit", _model(_IMPACT, law="link", **implicit)),
        _inside("link_distributed (20 elements), explicit", _model(_IMPACT, **spread, **explicit)),
        _inside("link_distributed (20 elements), implicit", _model(_IMPACT, **spread, **implicit)),
        _inside("link, explicit, tunable", _model(_IMPACT, law="link", tunable=True, **explicit)),
    ]


def _in_python() -> Sequence[Case]:
    model = _model(_IMPACT)
    medium = get_medium("play_sand")
    law = LinkLaw.from_medium(medium)
    sandy = _model(_IMPACT, law="link", scheme="explicit")
    by_hand = NumpySand(model, law, medium.density.value)
    explicit, implicit = (Sand(model, scheme=scheme) for scheme in ("explicit", "implicit"))
    return [
        _looped("mj_step without sand", model, lambda data: mujoco.mj_step(model, data)),
        _looped("plugin, explicit", sandy, lambda data: mujoco.mj_step(sandy, data)),
        _looped("Sand.step, explicit", model, explicit.step),
        _looped("Sand.step, implicit", model, implicit.step),
        _looped("the same law in NumPy", model, by_hand.step),
    ]


def _at_rest() -> Sequence[Case]:
    spread: dict[str, Any] = {"law": "link_distributed", "scheme": "implicit"}
    return [
        _inside("mj_step without sand", _model(_LARGE)),
        _rested("link_distributed (20 elements), implicit", _model(_LARGE, **spread)),
    ]


GROUPS = (
    Group(
        "One link, impact, inside mj_step",
        "The paper's link at 10 m/s in steps of 1 us, all steps in one call of `mj_step`: the "
        "price of sand without Python's.",
        _in_the_engine,
    ),
    Group(
        "One link, impact, Python's loop",
        "The same with a call from Python at each step: what `Sand.step` costs, and what a law "
        "written in NumPy would.",
        _in_python,
    ),
    Group("One link at rest, 1 ms", "The implicit scheme holds what lies still.", _at_rest),
)
