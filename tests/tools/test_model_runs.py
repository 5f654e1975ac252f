"""A user's own model on sand, and intruders on prescribed paths, through the command line."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mjgranular import errors
from mjgranular.calibrate import Body, Run, simulate
from mjgranular.cli import main
from mjgranular.experiment import Drop, Impact, run_drop, run_impact
from mjgranular.experiment.drop import start_from
from mjgranular.experiment.intrusion import Intrusion, run_intrusion
from mjgranular.models import Projectile, model_path

BALL = """
<mujoco>
  <worldbody>
    <geom name="box" type="box" size="0.2 0.2 0.05" pos="0 0 0.05" contype="0" conaffinity="0"/>
    <body name="ball" pos="0 0 1">
      <freejoint/>
      <geom name="ball" type="sphere" size="0.02" density="7800"/>
    </body>
  </worldbody>
  <keyframe><key name="high" qpos="0 0 2 1 0 0 0"/></keyframe>
</mujoco>
"""


SERVO = """
<mujoco>
  <option timestep="2e-3" integrator="implicitfast"/>
  <worldbody>
    <body name="foot" pos="0 0 0.03">
      <freejoint/>
      <geom type="box" size="0.05 0.05 0.03" mass="3"/>
      <body name="arm" pos="0 0 0.03">
        <joint name="lift" type="slide" axis="0 0 1"/>
        <geom type="sphere" size="0.02" pos="0 0 0.1" mass="1.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="lift" kp="2000" kv="60"/></actuator>
  <keyframe><key name="up" qpos="0 0 0.03 1 0 0 0 0.05" ctrl="0.05"/></keyframe>
</mujoco>
"""
WHEEL = """
<mujoco>
  <worldbody>
    <body name="foot" pos="0 0 0.03">
      <freejoint/>
      <geom name="sole" type="box" size="0.05 0.05 0.03" mass="3"/>
      <body name="wheel" pos="0 0 0.2">
        <joint axis="0 0 1"/>
        <geom type="cylinder" size="0.03 0.01" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="spins" qpos="0 0 0.03 1 0 0 0 0" qvel="0 0 0 0 0 0 20"/></keyframe>
</mujoco>
"""


def test_the_sampled_forces_are_those_with_the_controls(tmp_path):
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    result = run_drop(Drop(path, keyframe="up", duration=1.5, bodies="foot"))
    assert result.force[-1, 0, 2] == pytest.approx(4.5 * 9.81, rel=1e-3)


def test_keyframes_without_a_name_have_a_number():
    model = mujoco.MjModel.from_xml_string(SERVO.replace('name="up" ', ""))
    data = mujoco.MjData(model)
    start_from(model, data, "0")
    assert data.qpos[-1] == 0.05
    with pytest.raises(
        errors.UnknownNameError, match="no keyframe of the model 'up'; there are: 0"
    ):
        start_from(model, data, "up")


def test_a_model_of_which_a_part_turns_is_not_at_rest(tmp_path):
    path = tmp_path / "wheel.xml"
    path.write_text(WHEEL)
    result = run_drop(Drop(path, keyframe="spins", duration=0.5, bodies="foot"))
    assert result.rest is None
    assert abs(result.qvel[-1, :6]).max() < 0.1


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_bodies_are_lifted_together(slope, tmp_path):
    path = tmp_path / "two.xml"
    bodies = [
        f'<body pos="{x} 0 {z}"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>'
        for x, z in ((0.0, 0.5), (0.3, 0.05))
    ]
    path.write_text(f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>")
    result = run_drop(Drop(path, height=0.1, slope=slope, duration=1e-2))
    heights = result.qpos[0, [2, 9]]
    assert heights[0] - heights[1] == pytest.approx(0.45, abs=1e-12)
    assert result.depth[0].max() == pytest.approx(-0.1, abs=1e-9)


def test_the_greatest_force_does_not_depend_on_the_duration(ball):
    drop = Drop(ball, geoms="ball", height=0.1, duration=0.5)
    short, long = run_drop(drop), run_drop(replace(drop, duration=12.0))
    assert len(long.t) < 12.0 / long.timestep / 2
    for name in ("greatest_force", "greatest_depth"):
        assert getattr(long.bodies[0], name) == pytest.approx(getattr(short.bodies[0], name))


def test_an_intruder_keeps_the_orientation_that_it_has_in_its_model(tmp_path):
    forces = []
    for number, euler in enumerate(("0 0 0", "0 90 0")):
        path = tmp_path / f"{number}.xml"
        block = f'<body euler="{euler}"><geom type="box" size="0.04 0.04 0.01"/></body>'
        path.write_text(f"<mujoco><worldbody>{block}</worldbody></mujoco>")
        forces.append(run_intrusion(Intrusion(model=path, depth=0.05)).force[-1, 0])
    tilted = run_intrusion(Intrusion(model=tmp_path / "0.xml", depth=0.05, tilt=np.pi / 2))
    assert tilted.force[-1, 0] == pytest.approx(forces[1], rel=1e-9)
    assert forces[1] < 0.6 * forces[0]


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    return path


def test_drop_prints_and_writes(ball, tmp_path, capfd):
    folder = tmp_path / "run"
    arguments = ["drop", str(ball), "--height", "0.01", "--velocity", "1", "--duration", "0.1"]
    arguments += ["--geoms", "ball"]
    assert main([*arguments, "--json", "--out", str(folder)]) == 0
    summary = json.loads(capfd.readouterr().out)
    (body,) = summary["bodies"]
    assert body["body"] == "ball"
    assert 0.001 < body["greatest_depth"] < 0.05
    assert body["greatest_force"] > 0
    assert sorted(path.name for path in folder.iterdir()) == [
        "config.json",
        "drop.png",
        "summary.json",
        "trajectory.npz",
    ]
    assert main([*arguments, "--out", str(folder)]) == 2
    assert "--overwrite" in capfd.readouterr().err
    film = tmp_path / "film.mp4"
    small = ["--seconds", "0.5", "--width", "320", "--height", "240"]
    assert main(["render", str(folder), "--out", str(film), *small]) == 0
    assert film.stat().st_size > 1000


def test_energy_into_the_sand_is_what_the_ball_loses(ball):
    # In 25 steps of 2 ms the work would be summed too coarsely.
    drop = Drop(
        ball,
        medium="quikrete_medium",
        law="rft3d",
        height=0.0,
        velocity=2.0,
        duration=0.05,
        scheme="explicit",
    )
    result = run_drop(drop)
    (body,) = result.bodies
    mass = 7800 * 4 / 3 * np.pi * 0.02**3
    fallen = result.qpos[0, 2] - result.qpos[-1, 2]
    kinetic = [0.5 * mass * (v[:3] @ v[:3]) for v in (result.qvel[0], result.qvel[-1])]
    lost = kinetic[0] - kinetic[1] + mass * 9.81 * fallen
    assert body.energy_into_sand == pytest.approx(lost, rel=0.01)


def test_a_bed_is_sand_only_inside(ball):
    inside = run_drop(Drop(ball, medium="quikrete_medium", bed="box", height=0.0, duration=0.05))
    assert inside.bodies[0].greatest_depth > 0
    model = mujoco.MjModel.from_xml_string(BALL.replace('pos="0 0 1"', 'pos="1 0 1"'))
    beside = ball.with_name("beside.xml")
    mujoco.mj_saveLastXML(str(beside), model)
    away = run_drop(Drop(beside, medium="quikrete_medium", bed="box", duration=0.6))
    assert away.bodies[0].greatest_force == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--keyframe", "low"], ["low", "high"]),
        (["--bed", "ball"], ["sphere", "box"]),
        (["--bed", "boxx"], ["boxx", "box"]),
        (["--height-field", "dunes"], ["dunes"]),
        (["--bodies", "bal"], ["bal", "ball"]),
        (["--height", "-1"], ["height", "negative"]),
        (["--duration", "0"], ["duration", "positive"]),
        (["--timestep", "nan"], ["time step"]),
        (["--medium", "moon"], ["moon", "glass_beads"]),
        (["--law", "link"], ["link", "quikrete_medium"]),
        (["--law", "link", "--medium", "play_sand"], ["sphere", "slender"]),
        (["--slope", "90"], ["slope"]),
        (["--resolution", "1"], ["resolution"]),
        (["--camera", "back", "--video"], ["back", "free"]),
    ],
)
def test_mistakes_in_a_drop(ball, tmp_path, capfd, arguments, words):
    folder = tmp_path / "run"
    status = main(
        ["drop", str(ball), *arguments, "--duration", "0.01"][:-2]
        + ([] if "--duration" in arguments else ["--duration", "0.01"])
        + ["--out", str(folder)]
    )
    assert status == 2
    error = capfd.readouterr().err
    assert all(word in error for word in words), error
    assert "Traceback" not in error


def test_a_model_that_cannot_be_read(tmp_path, capfd):
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><body></mujoco>")
    for path in (broken, tmp_path / "nowhere.xml"):
        assert main(["drop", str(path)]) == 2
        assert "cannot load" in capfd.readouterr().err


def test_a_plate_pushed_down_meets_the_formula(capfd):
    assert main(["intrude", "--law", "rft3d", "--json", "--points", "6"]) == 0
    rows = json.loads(capfd.readouterr().out)
    mu = np.tan(np.radians(34))
    stiffness = 1550 * 9.81 * (894 * mu**3 - 386 * mu**2 + 89 * mu)
    for row in rows:
        expected = 0.87574 * stiffness * 0.04**2 * row["depth"]
        assert row["resistance"] == pytest.approx(expected, rel=1e-3, abs=1e-9)
        assert abs(row["lift"]) < 1e-9
    assert rows[-1]["depth"] == pytest.approx(0.1)


def test_paths_and_intruders(ball, tmp_path):
    level = run_intrusion(Intrusion("sphere", direction=0.0, start=0.05, distance=0.1, points=3))
    assert np.ptp(level.force, axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert level.force[0, 0] > 0
    assert level.force[0, 1] > 0  # a sphere drawn along is lifted
    own = run_intrusion(Intrusion(model=ball, geom="ball", points=3))
    same = run_intrusion(Intrusion("sphere", size=0.04, points=3))
    assert own.force == pytest.approx(same.force, rel=1e-9, abs=1e-9)
    with pytest.raises(errors.InputError, match="--distance"):
        Intrusion(direction=0.0)
    with pytest.raises(errors.InputError, match="never gets"):
        Intrusion(direction=-1.0)


def test_a_fast_push_accelerates_the_sand_that_moves_along():
    made = run_intrusion(Intrusion("sphere", speed=2.0, depth=0.02, points=101))
    columns = {"depth": made.depth[1:], "force": made.force[1:, 0]}
    push = Run("push", "intrude", columns, body=Body("sphere", 0.04), speed=2.0)
    means = (made.force[1:, 0] + made.force[:-1, 0]) / 2  # as those of `simulate`
    assert simulate(push, "quikrete_medium").force.sum() == pytest.approx(means.sum(), rel=0.01)


@pytest.mark.parametrize(("size", "speed"), [(3.0, 0.01), (0.04, 1e-6)])
def test_the_sand_does_not_stop_a_body_that_is_pushed(size, speed):
    made = run_intrusion(Intrusion(size=size, speed=speed, depth=size, points=11))
    columns = {"depth": made.depth[9:], "force": made.force[9:, 0]}
    push = Run("push", "intrude", columns, body=Body("plate", size / 10, size), speed=speed)
    assert simulate(push, "quikrete_medium").force[0] == pytest.approx(made.force[9, 0], rel=1e-3)


def test_a_vertical_push_has_no_lift_under_the_link_law():
    down = run_intrusion(Intrusion("capsule", law="link", medium="play_sand", points=3))
    assert down.force[:, 1:] == pytest.approx(np.zeros((3, 2)), abs=0.0)


def test_intrude_writes(tmp_path, capfd):
    folder = tmp_path / "run"
    assert main(["intrude", "--points", "5", "--out", str(folder)]) == 0
    assert sorted(path.name for path in folder.iterdir()) == [
        "config.json",
        "intrusion.csv",
        "intrusion.png",
        "summary.json",
    ]
    assert main(["intrude", "--geom", "g"]) == 2
    assert "model" in capfd.readouterr().err


@pytest.mark.parametrize("shape", ["sphere", "box", "cylinder", "capsule", "ellipsoid", "plate"])
def test_mass_and_inertia_of_other_bodies(shape):
    body = Projectile(0.06, 0.03, 2700, shape)
    spec = mujoco.MjSpec()
    solid = spec.worldbody.add_body()
    solid.add_freejoint()
    geom = body.spec().geom("link")
    solid.add_geom(type=geom.type, size=geom.size, density=2700)
    model = spec.compile()
    ours = body.model(1e-4).body("link")
    assert ours.mass[0] == pytest.approx(model.body_mass[1], rel=1e-12)
    assert sorted(ours.inertia) == pytest.approx(sorted(model.body_inertia[1]), rel=1e-9)


def test_a_sphere_dropped_as_katsuragi_and_durian_did(capfd):
    # physics.md section 2: v0 = 1 m/s stops after 0.0556 s, 0.0336 m deep.
    arguments = ["impact", "--body", "sphere", "--diameter", "0.0254", "--density", "8064"]
    arguments += ["--medium", "glass_beads", "--law", "depth_velocity", "--timestep", "1e-4"]
    assert main([*arguments, "--speed", "1", "--angle", "0", "--json"]) == 0
    row = json.loads(capfd.readouterr().out)
    assert row["stopping_time"] == pytest.approx(0.0556, rel=2e-3)
    assert row["depth"] == pytest.approx(0.0336, rel=2e-3)


def test_a_body_that_comes_to_rest_has_stopped():
    # Under the implicit scheme its velocity ends at 1e-13 m/s, of either sign.
    options = {"medium": "quikrete_medium", "law": "rft3d", "body": "box"}
    drop = Impact(speed=1.0, angle=0.35, length=0.06, diameter=0.04, duration=0.2, **options)
    stops = [run_impact(replace(drop, scheme=name)).stop for name in ("explicit", "implicit")]
    assert stops[1].time == pytest.approx(stops[0].time, rel=5e-3)
    assert stops[1].depth == pytest.approx(stops[0].depth, rel=1e-3)
    assert replace(drop, law=None).scheme_taken == "implicit"
    assert drop.scheme_taken == "explicit"


def test_models_that_come_with_the_package_run():
    for name in ("link", "double_pendulum", "chain7"):
        drop = Drop(model_path(name), law="link", duration=0.01)
        assert run_drop(drop).law == "link"


def test_a_robot_that_cannot_fall_is_named(tmp_path):
    """A walker to be attached to an arena has no free joint, and hung over the sand in silence."""
    path = tmp_path / "walker.xml"
    leg = '<body pos="0 0 -.1"><joint/><geom size=".05"/></body>'
    path.write_text(f'<mujoco><worldbody><body pos="0 0 .14">{leg}</body></worldbody></mujoco>')
    with pytest.warns(
        errors.GranularWarning, match="base is fixed to the world, and does not fall"
    ):
        run_drop(Drop(path, duration=0.01))


def test_a_model_that_asks_for_rk4_runs_with_another_integrator_and_says_so(ball):
    ball.write_text(BALL.replace("<worldbody>", '<option integrator="RK4"/><worldbody>', 1))
    with pytest.warns(errors.GranularWarning, match=r"ball\.xml asks for the integrator RK4"):
        result = run_drop(Drop(ball, height=0.01, duration=0.2))
    assert 'integrator="implicitfast"' in result.xml
    assert result.bodies[0].greatest_depth > 0.001


def test_a_foot_of_a_robot_is_moved_as_a_ball_of_its_size(tmp_path):
    """What drives, binds and reads the robot's joints, and its floor, is not in the way."""
    robot = tmp_path / "robot.xml"
    robot.write_text("""
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="torso" pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .02"/>
      <body name="leg"><joint name="hip" axis="0 1 0"/>
        <geom name="foot" size=".025" pos="0 0 -.2"/><site name="sole" pos="0 0 -.2"/>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="torso" body2="leg"/><pair geom1="foot" geom2="floor"/></contact>
  <tendon><fixed name="t"><joint joint="hip" coef="1"/></fixed></tendon>
  <equality><joint joint1="hip" active="false"/></equality>
  <actuator><motor joint="hip"/><motor tendon="t"/></actuator>
  <sensor><jointpos joint="hip"/><touch site="sole"/></sensor>
  <keyframe><key qpos="0 0 .3 1 0 0 0 .1"/></keyframe>
</mujoco>""")
    foot = run_intrusion(Intrusion(model=robot, geom="foot", depth=0.04, points=3))
    ball = run_intrusion(Intrusion(intruder="sphere", size=0.05, depth=0.04, points=3))
    np.testing.assert_allclose(foot.force, ball.force, rtol=1e-9, atol=1e-9)
