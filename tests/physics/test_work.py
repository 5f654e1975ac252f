"""The energy that goes into the sand, against the books of mechanics."""

import mujoco
import numpy as np
import pytest

from mjgranular import Sand
from mjgranular.experiment.sampling import WorkMeter

BLOCK = """
<mujoco>
  <option timestep="{timestep}"/>
  <worldbody>
    <body pos="0 0 0.15" euler="0 20 0">
      <freejoint/>
      <geom type="box" size="0.05 0.03 0.02" density="2000"/>
    </body>
  </worldbody>
</mujoco>
"""


def drop(timestep, **options):
    """Energy into the sand and mechanical energy lost, of a block that falls and is left [J]."""
    model = mujoco.MjModel.from_xml_string(BLOCK.format(timestep=timestep))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    sand, data = Sand(model, medium="quikrete_medium", **options), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before = data.energy.sum()
    meter = WorkMeter(sand, data)
    for _ in range(round(1.0 / timestep)):
        sand.step(data)
        meter.add()
    mujoco.mj_forward(model, data)
    return -meter.work.sum(), before - data.energy.sum()


@pytest.mark.parametrize("timestep", [1e-4, 1e-3, 2e-3, 1e-2])
def test_what_a_block_loses_is_in_the_sand(timestep):
    into_sand, lost = drop(timestep)
    # Gravity's work in Euler's steps is off by m g h v / 2, v its speed at touch-down, 1.5 m/s.
    assert into_sand == pytest.approx(lost, abs=1.1 * 0.48 * 9.81 * timestep * 1.5 / 2)


def test_the_explicit_scheme_has_the_same_books():
    into_sand, lost = drop(1e-4, law="rft3d", scheme="explicit")
    assert into_sand == pytest.approx(lost, rel=1e-3)


def test_work_is_counted_for_each_body():
    bodies = "".join(
        f'<body pos="{x} 0 0.1"><freejoint/><geom size="0.03" mass="{mass}"/></body>'
        for x, mass in ((0, 0.1), (1, 0.2))
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    sand, data = Sand(model, medium="quikrete_medium"), mujoco.MjData(model)
    meter = WorkMeter(sand, data)
    for _ in range(500):
        sand.step(data)
        meter.add()
    fallen = 9.81 * np.array([0.1, 0.2]) * (0.1 - data.qpos[2::7])
    np.testing.assert_allclose(-meter.work, fallen, rtol=0.02)
