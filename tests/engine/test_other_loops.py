"""The engine door in other people's loops: Gymnasium's environments, dm_control, MuJoCo Studio."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, DepthVelocityLaw, Plane, add_sand

BALL = """
<mujoco>
  <option timestep="1e-3"/>
  <worldbody>
    <geom name="tray" type="box" pos="0 0 -0.2" size="0.5 0.5 0.2"/>
    <body name="ball"><freejoint/><geom type="sphere" size="0.05"/></body>
  </worldbody>
</mujoco>
"""
LAW = DepthVelocityLaw(constant=1.0, stiffness=50.0, linear=1.0)


def sandy_xml(text: str, **arguments: Any) -> str:
    """A model with sand, as a file has it."""
    spec = mujoco.MjSpec.from_string(text)
    add_sand(spec, law=LAW, **arguments)
    return spec.to_xml()


def expected(text: str, velocity: float, steps: int) -> mujoco.MjData:
    """The same thrown at it in a loop of one's own."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[0] = velocity
    mujoco.mj_step(model, data, steps)
    assert 0.0 < data.qvel[0] < 0.99 * velocity
    return data


def test_an_environment_of_ones_own_in_gymnasium(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    pytest.importorskip("imageio")
    from gymnasium.envs.mujoco import MujocoEnv
    from gymnasium.spaces import Box

    text = sandy_xml(BALL, surface=Bed("tray"))
    path = tmp_path / "ball.xml"
    path.write_text(text)
    space = Box(-np.inf, np.inf, (7,), np.float64)
    env = MujocoEnv(str(path), frame_skip=5, observation_space=space)
    env.data.qvel[0] = 1.0
    env.do_simulation(np.zeros(0), 10)
    np.testing.assert_array_equal(env.data.qpos, expected(text, 1.0, 10).qpos)
    env.close()


def test_an_environment_of_gymnasiums_own(tmp_path: Path) -> None:
    gymnasium = pytest.importorskip("gymnasium")
    pytest.importorskip("imageio")
    import gymnasium.envs.mujoco as known

    folder = Path(known.__file__).parent / "assets"
    spec = mujoco.MjSpec.from_file(str(folder / "hopper.xml"))
    spec.delete(spec.geom("floor"))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    add_sand(spec, law=LAW, scheme="implicit", surface=Plane(0.05))
    path = tmp_path / "hopper.xml"
    path.write_text(spec.to_xml())
    heights = []
    for file in (str(path), "hopper.xml"):
        env = gymnasium.make("Hopper-v5", xml_file=file, terminate_when_unhealthy=False)
        observation, _ = env.reset(seed=1)
        for _ in range(20):
            observation, *_ = env.step(np.zeros(3))
        assert np.isfinite(observation).all()
        heights.append(env.unwrapped.data.body("foot").xpos[2])
        env.close()
    on_sand, on_the_floor = heights
    assert 0.01 < on_the_floor - on_sand < 0.15  # it sinks in, and does not fall through


def test_dm_control() -> None:
    physics_of = pytest.importorskip("dm_control.mujoco")
    text = sandy_xml(BALL, surface=Bed("tray"))
    try:
        physics_of.Physics.from_xml_string(BALL)
    except AttributeError as error:
        pytest.skip(f"this dm_control does not know MuJoCo {mujoco.__version__}: {error}")
    physics = physics_of.Physics.from_xml_string(text)
    with physics.reset_context():
        physics.data.qvel[0] = 1.0
    physics.step(10)
    other = physics.copy()
    for one in (physics, other):
        one.step(20)
        np.testing.assert_allclose(one.data.qpos, expected(text, 1.0, 30).qpos, rtol=1e-12)


STUDIO = """
import mujoco, mjgranular
from mujoco.studio import launch_web, step_control, viewer_protocol
model = mujoco.MjModel.from_xml_string({text!r})
data = mujoco.MjData(model)
data.qvel[0] = 1.0
config = viewer_protocol.ViewerConfig(gfx="web")
with launch_web.launch(config, plugins=[step_control.StepControl()]) as handle:
    handle.set_model(model, data=data)
    while data.time < 0.03 - 1e-9:
        handle.sync()
print("at", data.time, data.qvel[0], data.qfrc_passive.any())
"""


@pytest.mark.slow
def test_studio_steps_it() -> None:
    # What the browser draws is not looked at here.
    pytest.importorskip("mujoco.studio.launch_web", reason="MuJoCo Studio is not installed")
    text = sandy_xml(BALL, surface=Bed("tray"))
    done = subprocess.run(
        [sys.executable, "-c", STUDIO.format(text=text)],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    _, time, speed, acts = done.stdout[done.stdout.index("at ") :].split()[:4]
    assert acts == "True"
    steps = round(float(time) / 1e-3)
    assert float(speed) == expected(text, 1.0, steps).qvel[0]


FEET = """
<mujoco>
  <option timestep="2e-3" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 0.26"><freejoint/><geom type="box" size="0.1 0.05 0.05" mass="5"/>
      <body name="left" pos="0 0.15 -0.15">
        <joint name="left" axis="0 1 0" stiffness="200" damping="5"/>
        <geom type="box" size="0.15 0.05 0.1" mass="1"/>
      </body>
      <body name="right" pos="0 -0.15 -0.15">
        <joint name="right" axis="0 1 0" stiffness="200" damping="5"/>
        <geom type="box" size="0.15 0.05 0.1" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="left" gear="10"/><motor joint="right" gear="10"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("sands", [({},), ({"bodies": "left"}, {"bodies": "right"})])
def test_derivatives_by_controls_include_what_the_sand_changes(sands: Any) -> None:
    sensor = '<sensor><plugin plugin="mjgranular.sensor" objtype="body" objname="left">'
    sensor += '<config key="measure" value="moment"/><config key="sand" value="sand"/>'
    sensor += "</plugin></sensor></mujoco>"
    use = '<mujoco><extension><plugin plugin="mjgranular.sensor"/></extension>'
    text = FEET.replace("</mujoco>", sensor).replace("<mujoco>", use)
    spec = mujoco.MjSpec.from_string(text)
    for options in sands:
        add_sand(spec, draw=(), **options)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    nv, eps = model.nv, 1e-5
    speeds, moments = [], []
    for change in (eps, -eps):
        other = copy.copy(data)
        other.ctrl[0] = change
        mujoco.mj_step(model, other)
        speeds.append(other.qvel.copy())
        moments.append(other.sensordata.copy())
    found, states = np.zeros((2 * nv, 2)), np.zeros((2 * nv, 2 * nv))
    sensed = np.zeros((3, 2))
    mujoco.mjd_transitionFD(model, data, eps, True, states, found, None, sensed)
    expected_column = (speeds[0] - speeds[1]) / (2 * eps)
    assert np.abs(expected_column).max() > 1e-3
    np.testing.assert_allclose(found[nv:, 0], expected_column, atol=1e-5)
    expected_column = (moments[0] - moments[1]) / (2 * eps)
    assert np.abs(expected_column).max() > 1.0
    if mujoco.__version__.startswith("3.17"):
        sensed = -sensed  # of any sensor: MuJoCo subtracts the wrong way round
    np.testing.assert_allclose(sensed[:, 0], expected_column, atol=1e-4)
