"""Forces as damping, by which steps are made that Newton's method does not solve."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco import mujoco_env
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from mjgranular import Implicit, Sand
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import WORKSPACE, table_at
from mjgranular.kernel.vector import read_matrix, read_vector, write_vector
from mjgranular.scheme.balance import find_last_motions
from mjgranular.scheme.forces import secant
from mjgranular.scheme.workspace import workspace_at

ASSETS = Path(mujoco_env.__file__).parent / "assets"

BOX = """
<mujoco>
  <option timestep="{timestep}"/>
  <worldbody>
    <body name="box">
      <freejoint/><geom type="box" size="0.1 0.08 0.05" mass="2"/>
    </body>
  </worldbody>
</mujoco>
"""


@njit(error_model="numpy")
def secant_of(force, slope, u, out):
    c = secant(read_vector(force, 0), read_matrix(slope, 0), read_vector(u, 0))
    write_vector(out, 0, c.x)
    write_vector(out, 3, c.y)
    write_vector(out, 6, c.z)


vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(
    lambda v: np.linalg.norm(v) > 1e-2
)
matrices = st.lists(st.floats(-50.0, 50.0), min_size=9, max_size=9)


def test_a_force_nearly_across_the_motion_has_the_power_of_a_fiftieth():
    # F F^T / 0.02 |F| |v| on the page of the scheme, in place of F F^T / 0.01 |F| |v|.
    u, out = np.array([-0.01, math.sqrt(1 - 1e-4), 0.0]), np.empty(9)
    secant_of(np.array([1.0, 0.0, 0.0]), np.zeros(9), u, out)
    assert u @ out.reshape(3, 3) @ u == pytest.approx(0.01**2 / 0.02)


@given(force=vectors, slope=matrices, motion=vectors)
def test_a_secant_gives_the_force_and_takes_energy(force, slope, motion):
    force, u = np.array(force), np.array(motion) / np.linalg.norm(motion)
    if force @ u > -0.02 * np.linalg.norm(force):
        force -= (force @ u + 0.1 * np.linalg.norm(force)) * u  # it opposes the motion
    found = np.empty(9)
    secant_of(force, np.array(slope), u, found)
    matrix = found.reshape(3, 3)
    size = np.abs(matrix).max()
    assert matrix == pytest.approx(matrix.T, abs=1e-12 * size)
    assert matrix @ u == pytest.approx(-force, abs=1e-12 * size)
    assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * size
    # Across the motion it is at least as steep as the force itself.
    across = np.linalg.svd(u[None])[2][1:]
    steepest = np.linalg.eigvalsh(across @ (matrix + matrix.T) @ across.T / 2).max()
    symmetric = across @ (np.array(slope).reshape(3, 3) @ across.T)
    assert steepest >= np.linalg.eigvalsh((symmetric + symmetric.T) / 2).max() - 1e-9 * size


def thrown(count):
    """Poses at and in the sand, and velocities."""
    rng, model = np.random.default_rng(0), mujoco.MjModel.from_xml_string(BOX.format(timestep=2e-3))
    qpos = np.tile(model.qpos0, (count, 1))
    qvel = rng.normal(size=(count, model.nv)) * rng.choice([0.03, 0.3, 1.0], (count, 1))
    for row in qpos:
        mujoco.mj_integratePos(model, row, rng.normal(size=model.nv) * 0.3, 1.0)
    qpos[:, 2] = rng.uniform(-0.05, 0.08, count)
    return model, qpos, qvel


@pytest.mark.slow  # programs of its own
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_what_is_not_solved_ends_near_what_a_longer_search_finds():
    model, qpos, qvel = thrown(300)
    data = mujoco.MjData(model)
    ends = []
    for scheme in (Implicit(evaluations=1), Implicit()):
        sand = Sand(model, law="rft3d", medium="quikrete_medium", scheme=scheme)
        count, found, lost = 0, [], []
        for pose, velocity in zip(qpos, qvel, strict=True):
            mujoco.mj_resetData(model, data)
            data.qpos, data.qvel = pose, velocity
            sand.step(data)
            found.append(data.qvel.copy())
            unfinished = sand.report(data).solver.unfinished
            lost.append(unfinished > count)
            count = unfinished
        ends.append((np.array(found), np.array(lost)))
    (found, lost), (right, never) = ends
    assert 5 < lost.sum() < 60
    assert never.sum() <= 3
    error = np.linalg.norm(found - right, axis=1) / np.linalg.norm(right - qvel, axis=1)
    # With forces scaled down until they gave no energy it was 1 for most.
    assert np.median(error[lost]) <= 0.2
    assert np.quantile(error[~lost & ~never], 0.99) <= 1e-5


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
@pytest.mark.parametrize("law", ["rft3d", "rft3d_dynamic"])
def test_next_to_no_step_of_what_tumbles_is_left_unfinished(law):
    # 1 and 0 of some 6,800 steps; 8 and 18 if the solution is not followed from soft forces.
    model = mujoco.MjModel.from_xml_string(BOX.format(timestep=1e-2))
    sand, data = Sand(model, law=law, medium="quikrete_medium"), mujoco.MjData(model)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        for _ in range(40):
            mujoco.mj_resetData(model, data)
            mujoco.mj_integratePos(model, data.qpos, 2 * rng.normal(size=6), 1.0)
            data.qpos[:3] = [0, 0, 0.15]
            data.qvel[:] = rng.normal(size=6) * [2, 2, 2, 10, 10, 10]
            for _ in range(50):
                sand.step(data)
    solver = sand.report(data).solver
    assert solver.steps > 5000
    assert solver.unfinished <= 2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("robot", ["hopper", "half_cheetah"])
def test_a_robot_that_falls_and_lies_is_solved_in_each_step(robot):
    # Some elements turn about points at rest, while their sand gives momentum back (A5).
    spec = mujoco.MjSpec.from_file(str(ASSETS / f"{robot}.xml"))
    spec.delete(spec.geom("floor"))
    model = spec.compile()
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 2e-3
    sand, data = Sand(model, resolution=4), mujoco.MjData(model)
    for _ in range(2500):
        sand.step(data)
    solver = sand.report(data).solver
    assert solver.steps > 2000
    assert solver.unfinished == 0
    assert solver.evaluations < 10 * solver.steps


def test_the_energy_that_a_heavy_body_loses_does_not_throw_a_light_one():
    # Where the step is left unfinished: with forces of softer sand the light one left at 3 km/s.
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001"/><worldbody>
        <body pos="0 0 .01"><freejoint/><geom type="box" size=".01 .01 .01" mass="1e-6"/></body>
        <body pos="5 0 .5"><freejoint/><geom type="box" size=".5 .5 .5" mass="100"/></body>
        </worldbody></mujoco>"""
    )
    sand, data = Sand(model), mujoco.MjData(model)
    data.qvel[:] = [0.3, 0, -1, 1, 2, 0.3, 3, 0, -3, 0.3, 0.1, 0.2]
    speeds = []
    for _ in range(20):
        sand.step(data)
        speeds.append(np.linalg.norm(data.qvel[:3]))
    assert sand.report(data).solver.unfinished > 0
    assert max(speeds) < 1.1


def test_a_trunk_that_leans_over_a_foot_costs_no_more_than_rest():
    """The foot holds while the joints that place it turn: it starts from what it held before."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.002"/><worldbody><body pos="0 0 .6"><freejoint/>
        <geom type="capsule" size=".05 .3" mass="2"/><body pos="0 0 -.5">
        <joint axis="0 1 0" damping="1"/><geom type="box" size=".2 .2 .05" mass="5" pos="0 0 -.05"/>
        </body></body></worldbody></mujoco>"""
    )
    sand, data = Sand(model), mujoco.MjData(model)
    data.qvel[4] = 0.3
    for _ in range(500):
        sand.step(data)
    assert data.qvel[4] > 0.4
    solver = sand.report(data).solver
    assert solver.unfinished == 0
    assert solver.evaluations < 3 * solver.steps


TREE = """<mujoco><worldbody><body pos="0 0 .1"><freejoint/><geom size=".1"/>
<body pos=".3 .1 0"><joint type="ball" pos=".05 0 .02"/><geom type="box" size=".1 .05 .02"/>
<body pos=".2 0 0"><joint axis="1 1 0"/><joint axis="0 .3 1" pos="0 .1 0"/>
<joint type="slide" axis="0 1 1"/><geom type="capsule" size=".03 .1"/></body></body></body>
</worldbody></mujoco>"""


@compiled
def last_motions(address, found):
    """Copy the motions of the last step from a simulation's workspace."""
    w = workspace_at(table_at(address)[WORKSPACE])
    find_last_motions(w)
    for body in range(w.nbody):
        for k in range(6):
            found[body, k] = w.motion[body, k]


def test_motions_of_the_last_step_are_known_to_third_order():
    """Against MuJoCo's velocities in the configuration of that step."""
    model, errors = mujoco.MjModel.from_xml_string(TREE), []
    for timestep in (4e-3, 2e-3):
        rng = np.random.default_rng(1)
        then, now = mujoco.MjData(model), mujoco.MjData(model)
        model.opt.timestep = timestep
        mujoco.mj_integratePos(model, then.qpos, rng.normal(size=model.nv), 1.0)
        now.qpos[:] = then.qpos
        then.qvel[:] = now.qvel[:] = 2 * rng.normal(size=model.nv)
        mujoco.mj_integratePos(model, now.qpos, now.qvel, timestep)
        mujoco.mj_forward(model, then)
        mujoco.mj_forward(model, now)
        sand = Sand(model)
        sand.apply(now)
        found = np.zeros((model.nbody, 6))
        last_motions(sand.table_of(now), found)
        place = then.xpos[-1] + [0.1, 0.2, 0.3]
        velocity, expected = (
            motion[3:] + np.cross(motion[:3], place - data.subtree_com[1])
            for motion, data in ((found[-1], now), (then.cvel[-1], then))
        )
        errors.append(np.linalg.norm(velocity - expected))
    assert errors[1] < 1e-6
    assert errors[0] == pytest.approx(8 * errors[1], rel=0.02)
