"""Sensors of force and `cfrc_ext`: the same by both interfaces, and what MuJoCo makes of it."""

# pyright: reportPrivateImportUsage=false, reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import pickle
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from mjgranular import Plane, Sand
from mjgranular.engine import add_sand, rne_post_constraint, tune
from mjgranular.engine.config import SENSOR

pytestmark = [
    pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning"),
    # The robot has a touch sensor, which is to read as ever: of that a warning tells.
    pytest.mark.filterwarnings("ignore:MuJoCo's sensors:mjgranular.errors.UnfeltWarning"),
]

GRAVITY = 9.81
LOAD = 5.0  # [kg], above the ankle

# A foot in the sand under a load; beside it a ball that a weld holds, on a shelf of its own.
ROBOT = """
<mujoco>
  <option timestep="1e-3" integrator="implicitfast"/>
  <worldbody>
    <geom name="shelf" type="box" pos="2 0 1" size="0.3 0.3 0.1"/>
    <body name="load" pos="0 0 0.26"><freejoint/>
      <geom type="box" size="0.1 0.05 0.05" mass="5"/><site name="back" pos="0.05 0 0.02"/>
      <body name="foot" pos="0 0 -0.15">
        <joint name="ankle" axis="0 1 0" stiffness="200" damping="5"/>
        <site name="sole" type="box" size="0.2 0.2 0.02" pos="0 0 -0.1"/>
        <site name="s" euler="10 20 30" pos="0.01 0 0.02"/>
        <geom name="foot" type="box" size="0.15 0.1 0.1" mass="1"/>
      </body>
    </body>
    <body name="ball" pos="2 0 1.2"><freejoint/><geom size="0.1"/>
      <body name="arm" pos="0.3 0 0"><joint axis="0 1 0"/><geom size="0.05"/></body>
    </body>
  </worldbody>
  <equality><weld body1="ball" body2="load" active="false"/></equality>
  <actuator><motor name="m" joint="ankle"/></actuator>
  <sensor>
    <accelerometer site="back"/><accelerometer site="s"/>
    <force name="force" site="s"/><torque name="torque" site="s"/>
    <force name="cut" site="s" cutoff="3"/><touch site="sole"/>
    <framelinacc objtype="body" objname="foot"/><subtreelinvel body="load"/>
  </sensor>
</mujoco>"""
MEDIUM: dict[str, Any] = {"medium": "quikrete_medium", "law": "rft3d", "bodies": ["load", "foot"]}


def make_spec(integrator: str = "IMPLICITFAST", xml: str = ROBOT) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(xml)
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    return spec


def on_sand(
    scheme: str = "implicit", integrator: str = "IMPLICITFAST", **more: Any
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot on sand inside `mj_step`, in motion."""
    spec = make_spec(integrator)
    add_sand(spec, scheme=scheme, **MEDIUM, **more)
    measure(spec, "sand", ("load", "foot"))
    model = spec.compile()
    return model, moving(model)


def measure(spec: mujoco.MjSpec, sand: str, bodies: Sequence[str]) -> None:
    """Adds sensors of the sand's wrench on bodies, behind the robot's own."""
    spec.activate_plugin(SENSOR)
    for body in bodies:
        for what in ("force", "moment"):
            name = f"{what} of {sand} on {body}"
            plugin = spec.add_plugin(name=name, plugin_name=SENSOR, active=True)
            plugin.config = {"measure": what, "sand": sand}
            sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_PLUGIN)
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, body
            sensor.plugin.active = True
            sensor.plugin.plugin_name, sensor.plugin.name = SENSOR, name


def moving(model: mujoco.MjModel) -> mujoco.MjData:
    """A simulation in which all that can be is in motion, and forces of the user's act."""
    rng = np.random.default_rng(1)
    data = mujoco.MjData(model)
    data.qpos[2] -= 0.05
    data.qvel[:] = 0.2 * rng.normal(size=model.nv)
    data.ctrl[:] = 3.0
    data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
    data.qfrc_applied[:] = rng.normal(size=model.nv)
    return data


def assert_same_sensors(mine: mujoco.MjData, theirs: mujoco.MjData, rtol: float = 1e-9) -> None:
    for name in ("sensordata", "cfrc_ext", "cfrc_int", "cacc"):
        a, b = getattr(mine, name), getattr(theirs, name)
        if name == "sensordata":  # behind the robot's own are those of the sand
            a = a[: b.size]
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * np.abs(b).max(), err_msg=name)


def pushed(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """The simulation without sand in the model, but with its forces as the user's, in one place."""
    bare = make_spec().compile()
    bare.opt.integrator = model.opt.integrator
    twin = mujoco.MjData(bare)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(bare, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(bare, twin, state, kind)
    twin.xfrc_applied[1:3] += data.sensordata[-12:].reshape(2, 6)
    return twin


def test_an_ankle_bears_what_stands_on_it() -> None:
    spec = make_spec()
    add_sand(spec, **MEDIUM)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1500)
    angle = data.site("s").xmat.reshape(3, 3)
    assert angle @ data.sensor("force").data == pytest.approx([0, 0, -LOAD * GRAVITY], abs=0.01)
    assert data.body("foot").cfrc_ext[3:] == pytest.approx([0, 0, 6 * GRAVITY], abs=0.01)


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICIT", "IMPLICITFAST"])
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
def test_sensors_agree_by_both_interfaces(scheme: str, integrator: str) -> None:
    model, mine = on_sand(scheme, integrator)
    bare = make_spec(integrator).compile()
    theirs = moving(bare)
    sand = Sand(bare, scheme=scheme, **MEDIUM)
    own = mine.xfrc_applied.copy()
    for step in range(60):
        if step == 30:  # as contacts do, a weld acts on bodies too
            mine.eq_active[0] = theirs.eq_active[0] = 1
        mujoco.mj_step(model, mine)
        sand.step(theirs)
        assert_same_sensors(mine, theirs, 1e-7)
        assert mine.xfrc_applied.tobytes() == own.tobytes()
    assert np.abs(mine.cfrc_ext[2]).max() > 10
    assert np.abs(mine.sensor("force").data).max() > 10
    assert np.abs(mine.sensor("cut").data).max() == 3


@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
def test_sensors_are_what_mujoco_makes_of_the_same_forces(scheme: str) -> None:
    model, data = on_sand(scheme)
    mujoco.mj_step(model, data, 5)
    mujoco.mj_forward(model, data)
    twin = pushed(model, data)
    mujoco.mj_forward(twin_model := make_spec().compile(), twin)
    assert twin_model.nbody == model.nbody
    assert_same_sensors(data, twin)


def test_forces_written_between_the_halves_of_a_step_stay_and_are_felt() -> None:
    model, mine = on_sand()
    bare = make_spec().compile()
    theirs = moving(bare)
    sand = Sand(bare, scheme="implicit", **MEDIUM)
    own = np.random.default_rng(2).normal(size=(model.nbody, 6))
    own[0] = 0
    # What is written behind the sand's forces is felt by the step as by MuJoCo's own fluid.
    mine.xfrc_applied[:], theirs.xfrc_applied[:] = own, own
    mujoco.mj_step1(model, mine)
    mine.xfrc_applied[1] += 5.0
    mujoco.mj_step2(model, mine)
    assert np.array_equal(mine.xfrc_applied[1], own[1] + 5.0)
    sand.step(theirs)
    change = mine.cfrc_ext[1, 3:] - theirs.cfrc_ext[1, 3:]
    assert change == pytest.approx(np.full(3, 5.0), rel=1e-9)
    assert mine.cfrc_ext[2] == pytest.approx(theirs.cfrc_ext[2], rel=1e-9)


def test_in_a_rollout_and_after_a_reset() -> None:
    model, data = on_sand()
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    begin = copy.copy(data)
    data.xfrc_applied[:], data.qfrc_applied[:] = 0, 0
    readings = np.zeros((20, model.nsensordata))
    for row in readings:
        mujoco.mj_step(model, data)
        row[:] = data.sensordata
    fresh = mujoco.MjData(model)
    _, rolled = rollout.rollout(
        model, fresh, state, np.full((1, 20, 1), 3.0), initial_warmstart=begin.qacc_warmstart
    )
    np.testing.assert_array_equal(rolled[0], readings)
    mujoco.mj_resetData(model, data)
    assert not data.sensordata.any()
    other = mujoco.MjData(model)
    for one in (data, other):
        mujoco.mj_step(model, one, 3)
    np.testing.assert_array_equal(data.sensordata, other.sensordata)
    np.testing.assert_array_equal(data.cfrc_ext, other.cfrc_ext)


def test_in_a_batch() -> None:
    model, data = on_sand()
    batch = pytest.importorskip("mujoco.batch").Batch(model, 3, 2)
    batch.reset()
    for name in ("qpos", "qvel", "ctrl", "xfrc_applied", "qfrc_applied"):
        batch.bind(name)[:] = getattr(data, name)
    readings, forces = batch.bind("sensordata"), batch.bind("cfrc_ext")
    batch.step(nstep=10)
    mujoco.mj_step(model, data, 10)
    np.testing.assert_array_equal(readings, np.tile(data.sensordata, (3, 1)))
    np.testing.assert_array_equal(forces, np.tile(data.cfrc_ext, (3, 1, 1)))
    assert np.abs(data.cfrc_ext[2]).max() > 10


def test_inverse_dynamics_take_the_sand_as_a_passive_force() -> None:
    model, data = on_sand()
    mujoco.mj_step(model, data, 5)
    mujoco.mj_forward(model, data)
    twin = copy.copy(data)
    mujoco.mj_inverse(model, data)
    assert_same_sensors(data, twin)
    given = data.qfrc_applied + data.qfrc_actuator
    for body in range(1, model.nbody):
        wrench = data.xfrc_applied[body]
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[body], body, given)
    assert data.qfrc_inverse == pytest.approx(given, abs=1e-6)


def test_asking_again_adds_nothing() -> None:
    model, data = on_sand()
    mujoco.mj_forward(model, data)
    before = copy.copy(data)
    for _ in range(3):
        mujoco.mj_sensorAcc(model, data)
    assert_same_sensors(data, before, 1e-15)


def test_mujocos_own_function_leaves_the_sand_out_and_ours_has_it() -> None:
    model, data = on_sand()
    mujoco.mj_forward(model, data)
    before, own = copy.copy(data), data.xfrc_applied.copy()
    mujoco.mj_rnePostConstraint(model, data)
    assert np.abs(data.cfrc_ext[2] - before.cfrc_ext[2]).max() > 10
    rne_post_constraint(model, data)
    assert_same_sensors(data, before, 1e-15)
    assert data.xfrc_applied.tobytes() == own.tobytes()
    bare = make_spec().compile()
    empty = moving(bare)
    Sand(bare, **MEDIUM).step(empty)  # puts xfrc_applied back, with the same effect
    assert np.abs(empty.cfrc_ext[2]).max() > 10
    mujoco.mj_rnePostConstraint(bare, empty)
    assert empty.cfrc_ext[2, 3:] == pytest.approx(empty.xfrc_applied[2, :3])
    mujoco.mj_forward(bare, empty)
    twin = copy.copy(empty)
    rne_post_constraint(bare, empty)
    assert_same_sensors(empty, twin, 0)


def test_a_model_without_sensors_has_the_sand_in_cfrc_ext_when_it_is_asked_for() -> None:
    model, data = on_sand()
    spec = make_spec()
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    add_sand(spec, scheme="implicit", **MEDIUM)
    plain = spec.compile()
    assert plain.nsensor == plain.nsensordata == 0
    twin = moving(plain)
    mujoco.mj_step(model, data, 5)
    mujoco.mj_step(plain, twin, 5)
    np.testing.assert_array_equal(twin.qpos, data.qpos)
    assert np.abs(twin.cfrc_ext[2] - data.cfrc_ext[2]).max() > 10
    rne_post_constraint(plain, twin)
    np.testing.assert_array_equal(twin.cfrc_ext, data.cfrc_ext)
    assert np.abs(twin.cfrc_ext[2]).max() > 10


@pytest.mark.parametrize("what", ["delay", "interval"])
def test_sensors_that_look_back(what: str) -> None:
    """Readings of the past are of the sand too, whoever asks first."""
    option = {"delay": 'nsample="4" delay="2e-3"', "interval": 'nsample="4" interval="2e-3"'}[what]
    xml = ROBOT.replace('<force name="force"', f'<force name="force" {option}')
    try:
        bare = mujoco.MjModel.from_xml_string(xml)
    except ValueError:
        pytest.skip("this MuJoCo has no such sensors")
    spec = mujoco.MjSpec.from_string(xml)
    add_sand(spec, scheme="implicit", **MEDIUM)
    model = spec.compile()
    mine, theirs = moving(model), moving(bare)
    sand = Sand(bare, scheme="implicit", **MEDIUM)
    for _ in range(20):
        mujoco.mj_step(model, mine)
        sand.step(theirs)
        assert_same_sensors(mine, theirs, 1e-7)
    assert np.abs(mine.sensor("force").data).max() > 10


@pytest.fixture
def seen() -> Any:
    """What a callback for sensors of the user's has seen."""
    found: list[np.ndarray] = []
    yield found
    mujoco.set_mjcb_sensor(None)


def test_sensors_of_the_users_see_the_sand(seen: list[np.ndarray]) -> None:
    spec = make_spec()
    spec.add_sensor(
        type=mujoco.mjtSensor.mjSENS_USER,
        dim=1,
        needstage=mujoco.mjtStage.mjSTAGE_ACC,
        datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
    )
    add_sand(spec, scheme="implicit", **MEDIUM)
    model = spec.compile()
    data = moving(model)
    address = int(model.sensor_adr[-1])
    own = data.xfrc_applied.copy()

    def read(model: mujoco.MjModel, data: mujoco.MjData, stage: int) -> None:
        if stage == int(mujoco.mjtStage.mjSTAGE_ACC):
            data.sensordata[address] = data.cfrc_ext[2, 5]
            seen.append(data.xfrc_applied.copy())

    mujoco.set_mjcb_sensor(read)
    mujoco.mj_step(model, data)
    assert data.sensordata[address] == data.cfrc_ext[2, 5] > 10
    assert len(seen) == 2
    assert all(np.array_equal(applied, own) for applied in seen)

    def fail(model: mujoco.MjModel, data: mujoco.MjData, stage: int) -> None:
        if stage == int(mujoco.mjtStage.mjSTAGE_ACC) and data.cfrc_ext[2, 5] > 10:
            raise RuntimeError("no")

    mujoco.set_mjcb_sensor(fail)
    with pytest.raises(RuntimeError, match="no"):
        mujoco.mj_forward(model, data)
    assert data.xfrc_applied.tobytes() == own.tobytes()
    mujoco.set_mjcb_sensor(read)
    mujoco.mj_forward(model, data)
    assert data.sensordata[address] == data.cfrc_ext[2, 5] > 10


def test_two_sands_are_both_felt() -> None:
    spec = make_spec()
    for height in (0.0, 0.03):
        add_sand(spec, **MEDIUM | {"bodies": ["foot"]}, surface=Plane(height), tunable=height > 0)
    for sand in ("sand", "sand_2"):
        measure(spec, sand, ("foot",))
    model = spec.compile()
    data = moving(model)
    own = data.xfrc_applied.copy()
    for active in (1.0, 0.0):
        tune(model, data.plugin_state, "sand_2", active=active)
        mujoco.mj_forward(model, data)
        forces = [data.sensor(f"force of {sand} on foot").data for sand in ("sand", "sand_2")]
        assert np.abs(forces[0]).max() > 1
        assert (np.abs(forces[1]).max() > 1) == (active == 1)
        expected = sum(forces) + own[2, :3]
        assert data.cfrc_ext[2, 3:] == pytest.approx(expected, rel=1e-12)
        assert data.xfrc_applied.tobytes() == own.tobytes()


def test_where_passive_forces_are_off_sensors_have_no_sand() -> None:
    model, data = on_sand()
    mujoco.mj_forward(model, data)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(flags.mjDSBL_SPRING | flags.mjDSBL_DAMPER)
    mujoco.mj_forward(model, data)
    assert data.cfrc_ext[2, 3:] == pytest.approx(data.xfrc_applied[2, :3])


def test_where_sensors_are_off_nothing_is_worked_out() -> None:
    model, data = on_sand()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    mujoco.mj_step(model, data)
    assert not data.sensordata.any()
    assert not data.cfrc_ext.any()
    rne_post_constraint(model, data)
    assert np.abs(data.cfrc_ext[2]).max() > 10


def test_trees_that_sleep_keep_their_readings() -> None:
    spec = make_spec()
    try:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    except AttributeError:
        pytest.skip("in this MuJoCo nothing sleeps")
    for element in (*spec.actuators, *spec.equalities):  # they keep their trees awake
        spec.delete(element)
    add_sand(spec, **MEDIUM)
    model = spec.compile()
    data = mujoco.MjData(model)
    body = model.body("foot").id
    kept = np.zeros(3)
    for _ in range(3000):
        if data.body_awake[body] == int(mujoco.mjtSleepState.mjS_ASLEEP):
            break
        kept = data.sensor("force").data.copy()
        mujoco.mj_step(model, data)
    assert data.body_awake[body] == int(mujoco.mjtSleepState.mjS_ASLEEP)
    assert np.linalg.norm(kept) == pytest.approx(LOAD * GRAVITY, rel=0.05)
    mujoco.mj_step(model, data, 5)
    assert data.sensor("force").data == pytest.approx(kept, rel=0.05, abs=0.1)
    assert not data.cfrc_ext[body].any()


def test_a_simulation_from_a_pickle_knows_its_forces_after_a_step() -> None:
    model, data = on_sand()
    mujoco.mj_step(model, data, 3)
    twin = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(twin.sensordata, data.sensordata)
    rne_post_constraint(model, twin)
    assert twin.cfrc_ext[2, 3:] == pytest.approx(twin.xfrc_applied[2, :3])
    for one in (data, twin):
        mujoco.mj_forward(model, one)
    np.testing.assert_array_equal(twin.sensordata, data.sensordata)
    np.testing.assert_array_equal(twin.cfrc_ext, data.cfrc_ext)


def test_sensors_do_not_change_the_motion() -> None:
    model, data = on_sand()
    quiet = copy.copy(data)
    mute = copy.copy(model)
    mute.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    mujoco.mj_step(model, data, 50)
    mujoco.mj_step(mute, quiet, 50)
    np.testing.assert_array_equal(data.qpos, quiet.qpos)
    np.testing.assert_array_equal(data.qvel, quiet.qvel)
    np.testing.assert_array_equal(data.qfrc_passive, quiet.qfrc_passive)


def test_a_sensor_of_the_sand_itself_is_refused() -> None:
    spec = make_spec()
    add_sand(spec, **MEDIUM)
    sensor = '<sensor><plugin plugin="mjgranular.sand" instance="sand"/>'
    xml = spec.to_xml().replace("<sensor>", sensor)
    with pytest.raises(ValueError, match=r"measures nothing: .* plugin mjgranular\.sensor"):
        mujoco.MjModel.from_xml_string(xml)


TOUCH = """
    <plugin name="{name}" plugin="mjgranular.sensor" objtype="{kind}" objname="{name}">
      <config key="measure" value="touch"/></plugin>"""
EXTENSION = """
  <extension>
    <plugin plugin="mjgranular.sand"><instance name="sand">
      <config key="medium" value="quikrete_medium"/><config key="bodies" value="load foot"/>
    </instance></plugin>
    <plugin plugin="mjgranular.sensor"/>
  </extension>"""


def test_touch() -> None:
    sites = {
        "box": 'type="box" size="0.2 0.2 0.02" pos="0 0 -0.1"',
        "half": 'type="box" size="0.1 0.2 0.02" pos="0.1 0 -0.1"',
        "sphere": 'size="0.3"',
        "capsule": 'type="capsule" size="0.2 0.1"',
        "cylinder": 'type="cylinder" size="0.3 0.2"',
        "ellipsoid": 'type="ellipsoid" size="0.3 0.2 0.2"',
        "above": 'size="0.05" pos="0 0 0.1"',
    }
    written = "".join(f'<site name="{name}" {text}/>' for name, text in sites.items())
    sensors = "".join(TOUCH.format(name=name, kind="site") for name in sites)
    sensors += TOUCH.format(name="foot", kind="geom")
    xml = ROBOT.replace("<worldbody>", EXTENSION + "<worldbody>")
    xml = xml.replace('<site name="sole"', written + '<site name="sole"')
    model = mujoco.MjModel.from_xml_string(xml.replace("</sensor>", sensors + "</sensor>"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1500)
    read = {name: data.sensor(name).data[0] for name in (*sites, "foot")}
    weight = 6 * GRAVITY
    assert read["foot"] >= weight * (1 - 1e-6)
    assert read["foot"] == pytest.approx(weight, rel=0.2)
    assert read["above"] == 0
    for name in ("box", "sphere", "cylinder", "capsule", "ellipsoid"):
        assert read[name] == pytest.approx(read["foot"], rel=0.2), name
    assert read["half"] == pytest.approx(weight / 2, rel=0.2)


def test_touch_of_what_does_not_meet_the_sand_is_a_load_error() -> None:
    xml = ROBOT.replace("<worldbody>", EXTENSION + "<worldbody>")
    for kind, name, said in (
        ("geom", "shelf", "those that do:"),
        ("body", "ball", "those that do: load, foot"),
        ("camera", "eye", "objtype must be body, geom or site"),
    ):
        text = xml.replace("</sensor>", TOUCH.format(name=name, kind=kind) + "</sensor>")
        text = text.replace("<worldbody>", '<worldbody><camera name="eye"/>')
        with pytest.raises(ValueError, match=said):
            mujoco.MjModel.from_xml_string(text)
