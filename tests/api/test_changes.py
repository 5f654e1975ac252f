"""A model that is changed after `Sand` was made of it, and steps without the sand."""

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, Sand
from mjgranular.errors import MissedStepWarning

XML = """
<mujoco>
  <option timestep="2e-3"/>
  <asset><mesh name="m" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
  <worldbody>
    <body name="block" pos="0 0 .03"><freejoint/>
      <geom name="foot" type="box" size=".1 .05 .03"/>
      <geom name="seen" type="sphere" size=".01" contype="0" conaffinity="0"/>
      <body name="arm" pos=".2 0 0"><joint name="j" axis="0 1 0"/>
        <geom name="hand" type="mesh" mesh="m"/></body></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def sand():
    return Sand(mujoco.MjModel.from_xml_string(XML), law="rft3d", scheme="explicit")


def change(model, name, row, value):
    getattr(model, name)[row] = value


@pytest.mark.parametrize(
    ("name", "row", "value", "said"),
    [
        ("geom_size", (0, 0), 0.2, "geom_size of the model"),
        ("geom_pos", (0, 2), 0.1, "geom_pos of the model"),
        ("geom_quat", 2, [0, 1, 0, 0], "geom_quat of the model"),
        ("geom_type", 0, 6 - 2, "geom_type of the model"),
        ("geom_contype", 1, 1, "selection of geoms that meet the sand"),
        ("body_pos", (2, 0), 0.3, "body_pos of the model"),
        ("jnt_axis", (1, 0), 1.0, "jnt_axis"),
        ("mesh_vert", (0, 0), 0.01, "mesh_vert"),
    ],
)
def test_a_change_is_found_and_named(sand, name, row, value, said):
    sand.check()
    change(sand.model, name, row, value)
    with pytest.raises(InputError, match=f"{said}.* was changed after Sand was made"):
        sand.check()


def test_a_report_looks_at_the_shapes_of_geoms(sand):
    data = mujoco.MjData(sand.model)
    sand.report(data)
    sand.model.geom_size[0] *= 2
    with pytest.raises(InputError, match="geom_size of the model"):
        sand.report(data)


def test_what_may_change(sand):
    model = sand.model
    model.opt.timestep, model.opt.gravity[2] = 1e-3, -1.6
    model.body_mass[:] *= 2
    model.geom_size[1] *= 2  # does not meet the sand
    model.body_pos[1] = [1, 2, 3]
    model.geom_rgba[:] = 1
    sand.check(mujoco.MjData(model))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(InputError, match="RK4"):
        sand.check()


@pytest.mark.parametrize("look", ["check", "report"])
def test_steps_without_the_sand(sand, look):
    model, data = sand.model, mujoco.MjData(sand.model)
    found = getattr(sand, look)
    mujoco.mj_step(model, data)
    if look == "check":
        with pytest.warns(MissedStepWarning, match="never acted in this MjData"):
            found(data)
    else:
        found(data)  # the state may be from elsewhere
    sand.step(data)
    found(data)
    model.opt.timestep /= 4
    found(data)
    sand.step(data)
    found(data)
    mujoco.mj_step1(model, data)
    sand.apply(data)
    found(data)
    mujoco.mj_step2(model, data)
    found(data)
    mujoco.mj_resetData(model, data)
    found(data)
    sand.step(data)
    mujoco.mj_step(model, data)
    before = data.qpos.copy()
    with pytest.warns(MissedStepWarning, match=r"mj_step called in place of sand\.step"):
        found(data)
    assert np.array_equal(data.qpos, before)
    sand.step(data)
    found(data)
