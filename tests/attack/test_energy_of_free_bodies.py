"""A free body whose mass centre is off its origin, tumbling in sand: its true work.

The integrator `implicitfast` takes the gyroscopic moment of such a body implicitly. Its mass
couples turning and moving then, and the matrix has to be the engine's to the last entry.
"""

import mujoco
import numpy as np
import pytest

from mjgranular import Sand

MODEL = """
<mujoco>
  <option timestep="{timestep}" integrator="{integrator}"/>
  <worldbody>
    <body pos="0 0 -0.05" quat="{turn}">
      <freejoint/>
      <geom type="capsule" size="0.012 0.18" pos="{center}" quat="{lie}" density="800"/>
      {more}
    </body>
  </worldbody>
</mujoco>
"""


def words(values):
    return " ".join(f"{value:.4g}" for value in values)


def drawn(seed, integrator, *, off=True, more=""):
    rng = np.random.default_rng(seed)
    text = MODEL.format(
        timestep=rng.choice([1e-3, 2e-3, 5e-3]),
        integrator=integrator,
        turn=words(rng.normal(size=4)),
        lie=words(rng.normal(size=4)),
        center=words(rng.uniform(-0.2, 0.2, 3)) if off else "0 0 0",
        more=more,
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:] = rng.normal(scale=8.0, size=model.nv)
    return model, data


def greatest_work(model, data, steps=30):
    """Of the sand in a step, over the kinetic energy; with the velocities that it ends with."""
    sand = Sand(model, law="link_distributed", scheme="implicit")
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    product, greatest = np.zeros(model.nv), -np.inf
    for _ in range(steps):
        mujoco.mj_step1(model, data)
        sand.apply(data)
        mujoco.mj_jacBodyCom(model, data, linear, angular, 1)
        wrench = data.xfrc_applied[1]
        force = linear.T @ wrench[:3] + angular.T @ wrench[3:]
        mujoco.mj_mulM(model, data, product, data.qvel)
        kinetic = 0.5 * product @ data.qvel
        mujoco.mj_step2(model, data)
        work = model.opt.timestep * force @ data.qvel
        greatest = max(greatest, (work - 1e-12) / kinetic)
    return greatest


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "discrete"])
@pytest.mark.parametrize("seed", range(6))
def test_the_sand_gives_no_energy(seed, integrator):
    assert greatest_work(*drawn(seed, integrator)) <= 1e-10


@pytest.mark.parametrize("seed", range(6))
def test_nor_where_the_inertia_is_its_own(seed):
    more = '<inertial mass="1" pos="0.1 0.05 -0.02" quat="1 2 3 4" diaginertia="2e-3 3e-3 4e-3"/>'
    assert greatest_work(*drawn(seed, "implicitfast", more=more)) <= 1e-10


@pytest.mark.parametrize("seed", range(4))
def test_nor_where_the_mass_is_at_the_origin(seed):
    assert greatest_work(*drawn(seed, "implicitfast", off=False)) <= 1e-10
