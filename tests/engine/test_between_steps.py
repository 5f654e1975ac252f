"""Sand in what comes between steps: halves of a step, copies made there, other orders of calls."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from mjgranular import Sand, add_sand

FEET = """
<mujoco>
  <option timestep="1e-3" integrator="implicitfast"/>
  <worldbody>
    <body name="trunk" pos="0 0 0.24"><freejoint/><geom type="box" size="0.1 0.05 0.05" mass="2"/>
      <body name="left" pos="0 0.15 -0.15">
        <joint name="left" axis="0 1 0" damping="0.1"/>
        <geom type="box" size="0.15 0.05 0.1" mass="1"/>
      </body>
      <body name="right" pos="0 -0.15 -0.15">
        <joint name="right" axis="0 1 0" damping="0.1"/>
        <geom type="box" size="0.15 0.05 0.1" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="left" gear="5"/><motor joint="right" gear="5"/></actuator>
</mujoco>"""
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
LEFT: dict[str, Any] = {"bodies": "left", "law": "rft3d", "scheme": "implicit"}
RIGHT: dict[str, Any] = {"bodies": "right", "law": "rft3d", "scheme": "explicit"}
TRUNK: dict[str, Any] = {**RIGHT, "bodies": "trunk"}


def feet(*sands: dict[str, Any]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A model on two feet in these sands, while it sinks in."""
    spec = mujoco.MjSpec.from_string(FEET)
    for options in sands:
        add_sand(spec, draw=(), **options)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[2] = -0.5
    data.ctrl[:] = 0.3, -0.4
    mujoco.mj_step(model, data, 30)
    return model, data


def state_of(data: mujoco.MjData) -> np.ndarray:
    state = np.zeros(mujoco.mj_stateSize(data.model, STATE))
    mujoco.mj_getState(data.model, data, state, STATE)
    return state


@pytest.mark.parametrize(
    "copied", [copy.copy, lambda data: pickle.loads(pickle.dumps(data))], ids=["copy", "pickle"]
)
@pytest.mark.parametrize("options", [{}, {"memory": 0.02}], ids=["plain", "memory"])
def test_a_copy_between_the_halves_of_a_step_ends_it_alike(
    options: dict[str, Any], copied: Callable[[mujoco.MjData], mujoco.MjData]
) -> None:
    model, data = feet(options)
    model.opt.timestep = 5e-4  # the copy must not read what it was prepared with
    mujoco.mj_step1(model, data)
    twin = copied(data)
    for one in (data, twin):
        mujoco.mj_step2(one.model, one)
    np.testing.assert_array_equal(state_of(twin), state_of(data))


@pytest.mark.parametrize("more", [(RIGHT,), (TRUNK, RIGHT)], ids=["one", "two"])
def test_explicit_sands_after_an_implicit_one_act_once(more: tuple[dict[str, Any], ...]) -> None:
    """Whatever was computed before; and before the implicit one, which takes account of them."""
    model, data = feet(LEFT, *more)
    bare = mujoco.MjModel.from_xml_string(FEET)
    sands, twin = [Sand(bare, **options) for options in (*more, LEFT)], mujoco.MjData(bare)
    state = state_of(data)
    fresh = mujoco.MjData(model)
    mujoco.mj_setState(model, fresh, state, STATE)
    mujoco.mj_setState(bare, twin, state, STATE)
    mujoco.mj_step1(bare, twin)
    for sand in sands:
        sand.apply(twin)
    mujoco.mj_step2(bare, twin)
    nv = model.nv
    states, controls = np.zeros((2 * nv, 2 * nv)), np.zeros((2 * nv, model.nu))
    for one in (data, fresh):
        mujoco.mj_step(model, one)
        np.testing.assert_allclose(one.qvel, twin.qvel, atol=1e-9)
    for other in (data, copy.copy(data)):
        mujoco.mj_setState(model, other, state, STATE)
        mujoco.mjd_transitionFD(model, other, 1e-6, False, states, controls, None, None)
        assert np.abs(controls).max() < 10.0  # differences of the same order of forces
        mujoco.mj_setState(model, other, state, STATE)
        mujoco.mj_step(model, other)
        np.testing.assert_array_equal(state_of(other), state_of(fresh))
