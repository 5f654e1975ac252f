"""Sand in MuJoCo Warp, on its CPU back end: against `Sand`, and against what physics asks."""

import pathlib
import subprocess
import sys

import gymnasium.envs.mujoco
import mujoco
import numpy as np
import pytest

import mjgranular
from mjgranular import DepthVelocityLaw, Explicit, InputError, Plane, Sand, envs
from mjgranular.envs.ground import place

pytestmark = pytest.mark.slow
mjw = pytest.importorskip("mujoco_warp")

# One model for all, because each is compiled: a box, a rod, and a leg of two links.
SCENE = """
<mujoco>
  <option timestep="0.002" integrator="discrete"/>
  <asset><hfield name="dunes" nrow="12" ncol="12" size="2 2 0.05 0.1"/></asset>
  <worldbody>
    <geom name="dunes" type="hfield" hfield="dunes"/>
    <geom name="tray" type="box" size="1 1 0.1" pos="0 0 -0.1"/>
    <body name="box" pos="0 0 0.06">
      <freejoint/><geom type="box" size="0.1 0.08 0.05" mass="2"/>
    </body>
    <body name="rod" pos="0.5 -0.1 0.06">
      <freejoint/><geom type="capsule" size="0.01 0.1" mass="0.1" pos="0 0.1 0"/>
    </body>
    <body name="thigh" pos="0 0.5 0.3">
      <joint name="slide" type="slide" axis="0 0 1"/>
      <joint name="hip" axis="0 1 0" range="-60 60"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" mass="1"/>
      <body name="foot" pos="0 0 -0.15">
        <joint name="knee" axis="0 1 0" damping="0.1" range="-60 60"/>
        <geom type="box" pos="0 0 -0.1" size="0.05 0.03 0.01" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="knee"/></actuator>
</mujoco>
"""
PLACES = {
    "plane": Plane(slope=0.1, height=0.01),
    "bed": mjgranular.Bed("tray"),
    "dunes": mjgranular.HeightField("dunes"),
}


@pytest.fixture(scope="module")
def warp():
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from mjgranular import warp as sand_for_warp

    return sand_for_warp


def scene(warp):
    model = warp.coupled(mujoco.MjSpec.from_string(SCENE)).compile()
    model.hfield_data[:] = np.random.default_rng(1).random(model.nhfielddata)
    # Nothing meets but sand; kernels for contacts compile for ten seconds.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


def random_states(model, count, rng):
    """Bodies at and in the sand, moving."""
    qpos = np.tile(model.qpos0, (count, 1))
    qvel = rng.normal(size=(count, model.nv)) * rng.choice([0.03, 0.3, 1.0], (count, 1))
    for row in qpos:
        mujoco.mj_integratePos(model, row, rng.normal(size=model.nv) * 0.3, 1.0)
        row[[2, 9]] = rng.uniform(-0.05, 0.08, 2)  # heights of box and rod
        row[14] = rng.uniform(-0.1, 0.0)  # and of the leg
    return qpos, qvel


def put(model, qpos, qvel, sand):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    m = mjw.put_model(model)
    d = mjw.put_data(model, data, nworld=len(qpos), nconmax=16, njmax=64)
    d.qpos.assign(qpos.astype(np.float32))
    d.qvel.assign(qvel.astype(np.float32))
    d.qacc_warmstart.zero_()
    sand.attach(m, d)
    return m, d


@pytest.mark.parametrize(
    ("law", "medium", "place", "bodies"),
    [
        ("rft3d", "quikrete_medium", "dunes", ("box", "thigh", "foot")),
        ("rft3d inertia=1.1 rise=true", "quikrete_medium", "bed", ("box", "foot")),
        ("rft2d", "glass_beads", "plane", ("box", "rod", "foot")),
        ("rft3d_dynamic added=0 grain=1e-3", "quikrete_medium", "plane", ("box", "foot")),
        ("link", "play_sand", "plane", ("rod", "thigh")),
        ("link_distributed", "play_sand", "dunes", ("rod", "thigh")),
        (
            DepthVelocityLaw(constant=3, stiffness=500, exponent=1.3, linear=2, quadratic=8),
            None,
            "bed",
            ("box", "rod", "foot"),
        ),
    ],
    ids=lambda value: value.replace(" ", "_") if isinstance(value, str) else None,
)
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_forces_are_those_of_the_processor(warp, law, medium, place, bodies):
    """At the velocities of now, without softness, which the explicit scheme has none of."""
    model = scene(warp)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    given = {"law": law, "medium": medium, "surface": PLACES[place], "bodies": bodies}
    sand = warp.WarpSand(model, corrections=0, softness=0.0, **given)
    qpos, qvel = random_states(model, 200, np.random.default_rng(0))
    m, d = put(model, qpos, qvel, sand)
    m.opt.timestep.fill_(1e-13)  # so that it ends with the velocity of now
    mjw.step(m, d)

    reference = Sand(model, scheme=Explicit(half_step=False), **given)
    data, errors = mujoco.MjData(model), []
    force, moment, depth = sand.force.numpy(), sand.moment.numpy(), sand.depth.numpy()
    for world in range(len(qpos)):
        data.qpos, data.qvel = qpos[world], qvel[world]
        mujoco.mj_forward(model, data)
        report = reference.report(data)
        right = np.array([report[body].force for body in sand.bodies])
        largest = np.abs(right).max()
        if largest == 0:
            assert not force[world].any()
            continue
        arms = np.array([report[body].moment for body in sand.bodies])
        wrong = max(np.abs(force[world] - right).max(), np.abs(moment[world] - arms).max())
        errors.append(wrong / largest)
        for k, body in enumerate(sand.bodies):
            if report[body].depth > 0:
                assert depth[world, k] == pytest.approx(report[body].depth, abs=1e-6)
    assert len(errors) > 50
    assert np.quantile(errors, 0.95) <= 1e-4
    assert max(errors) <= 1e-2  # where single precision decides what is in the sand


def settled(model, sand, steps):
    """A state of the processor's implicit scheme after some steps."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for _ in range(steps):
        sand.step(data)
    return data


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_a_fall_ends_where_it_ends_on_the_processor_and_no_step_gives_energy(warp):
    model = scene(warp)
    given = {
        "law": "rft3d",
        "bodies": ("box", "rod", "thigh", "foot"),
        "instead_of": ("dunes", "tray"),
    }
    sand = warp.WarpSand(model, **given)
    m, d = put(model, np.tile(model.qpos0, (2, 1)), np.zeros((2, model.nv)), sand)
    sand.strength.assign(np.array([1.0, 2.0], np.float32))
    rows = [model.body(body).id for body in sand.bodies]
    for _ in range(150):
        places = d.qpos.numpy()
        mjw.step(m, d)
        # Forces belong to the velocity at the step's end, in the pose of its beginning.
        data, forces, moments = mujoco.MjData(model), sand.force.numpy(), sand.moment.numpy()
        for world in range(2):
            data.qpos, data.qvel = places[world], d.qvel.numpy()[world]
            mujoco.mj_forward(model, data)
            power, largest = 0.0, 0.0
            for k, body in enumerate(rows):
                velocity = np.zeros(6)
                mujoco.mj_objectVelocity(
                    model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, False
                )
                arm = data.xipos[body] - data.xpos[body]
                linear = velocity[3:] + np.cross(velocity[:3], arm)
                power += forces[world, k] @ linear + moments[world, k] @ velocity[:3]
                largest += np.linalg.norm(forces[world, k]) * np.linalg.norm(linear)
                largest += np.linalg.norm(moments[world, k]) * np.linalg.norm(velocity[:3])
            # Some roundings of single precision; what is stopped keeps one of its speed.
            assert power <= 1e-6 * largest + 1e-6
    reference = settled(model, Sand(model, **given, scheme="implicit"), 150)
    box = d.qpos.numpy()[:, 2]
    assert box[0] == pytest.approx(reference.qpos[2], abs=0.02 * (0.06 - reference.qpos[2]))
    assert box[1] > box[0] + 5e-4  # stronger sand
    weight = model.body("box").mass[0] * 9.81
    assert sand.force.numpy()[:, 0, 2] == pytest.approx([weight, weight], rel=1e-3)


def test_corrections_approach_the_step_of_the_processor(warp):
    """As docs/warp.md has it, with more states."""
    script = pathlib.Path(__file__).parents[2] / "benchmarks" / "warp_errors.py"
    found = subprocess.run(
        [sys.executable, script, "--names", "box", "--states", "40"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    medians = [float(line.split("median ")[1].split(",")[0]) for line in found.splitlines()[-3:]]
    assert 0.2 > medians[0] > 10 * medians[1]
    assert max(medians[1:]) < 2e-3


@pytest.mark.parametrize("timestep", [0.002, 0.01])
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_a_box_rests(warp, timestep):
    model = scene(warp)
    model.opt.timestep = timestep
    given = {"medium": "quikrete_medium", "bodies": "box", "instead_of": ("dunes", "tray")}
    data = settled(model, Sand(model, **given, scheme="implicit"), round(0.5 / timestep))
    sand = warp.WarpSand(model, **given)
    m, d = put(model, data.qpos[None], 0 * data.qvel[None], sand)
    for _ in range(round(0.2 / timestep)):
        mjw.step(m, d)
    start = d.qpos.numpy()[0, :7]
    for _ in range(round(0.5 / timestep)):
        mjw.step(m, d)
    assert np.abs(d.qpos.numpy()[0, :7] - start).max() <= 1e-6


@pytest.mark.parametrize("name", ["Hopper", "HalfCheetah", "Ant"])
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass'")
def test_a_robot_rests(warp, name):
    """On limbs that are loaded to the sand's limit, or bent against the limits of their joints."""
    task = envs.SandVectorEnv(name, 1).task
    spec = task.scene()
    (given,) = place(spec, task.sands)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.timestep = 0.01
    model = warp.coupled(spec).compile()
    falling = Sand(model, given, scheme="implicit")
    data = settled(model, falling, 600)
    sand = warp.WarpSand(model, given)
    m, d = put(model, data.qpos[None], 0 * data.qvel[None], sand)
    for _ in range(150):
        mjw.step(m, d)
    assert np.abs(d.qpos.numpy() - data.qpos).max() <= 1e-6  # some roundings of the first step
    weight = model.body_mass.sum() * 9.81
    assert sand.force.numpy()[0, :, 2].sum() == pytest.approx(weight, rel=1e-2)


HELD = """
<mujoco>
  <option timestep="0.002" integrator="discrete" cone="{cone}" jacobian="{jacobian}"/>
  <worldbody>
    <geom name="rock" type="box" size="0.1 0.1 0.1" pos="0.5 0 -0.05"/>
    <body name="leg" pos="0 0 0.097">
      <freejoint/>
      <geom type="box" size="0.1 0.08 0.02" mass="1" contype="2" conaffinity="0"/>
      <body name="foot" pos="0 0 -0.05">
        <joint name="knee" axis="0 1 0" damping="0.1" range="-20 20" frictionloss="0.1"/>
        <geom type="box" pos="0 0 -0.1" size="0.05 0.03 0.01" mass="0.3" contype="2"
          conaffinity="0"/>
      </body>
      <body name="arm" pos="0.5 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1"/>
        <geom type="sphere" size="0.05" mass="0.3" margin="0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="knee"/><adhesion body="arm" ctrlrange="0 10" gain="5"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("cone", "jacobian"), [("pyramidal", "dense"), ("elliptic", "sparse")], ids=lambda value: value
)
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_constraints_are_as_stiff_as_without_sand(warp, cone, jacobian):
    """Those of a limit, a dry joint, and a contact that sticks, by MuJoCo in the same states."""
    spec = mujoco.MjSpec.from_string(HELD.format(cone=cone, jacobian=jacobian))
    model = warp.coupled(spec).compile()
    sand = warp.WarpSand(model, medium="quikrete_medium", bodies=("leg", "foot"))
    data = mujoco.MjData(model)
    data.joint("knee").qpos[0] = 0.4  # beyond its limit
    data.qvel[:] = 0.1 * np.random.default_rng(0).normal(size=model.nv)
    data.ctrl[:] = [0.1, 4.0]
    m = mjw.put_model(model)
    d = mjw.put_data(model, data, nworld=2, nconmax=20, njmax=60)
    sand.attach(m, d)
    for _ in range(3):
        data.qpos, data.qvel = d.qpos.numpy()[1], d.qvel.numpy()[1]
        mujoco.mj_forward(model, data)
        mjw.step(m, d)
        assert np.abs(sand.force.numpy()[1]).max() > 1.0
        count = data.nefc
        assert d.nefc.numpy()[1] == count > 3
        for right, found in ((data.efc_D, d.efc.D), (data.efc_aref, d.efc.aref)):
            # Their order is not the same.
            right, found = np.sort(right), np.sort(found.numpy()[1, :count])
            assert found == pytest.approx(right, rel=1e-5, abs=1e-5 * np.abs(right).max())


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_what_rests_gives_way_where_it_does_on_the_processor(warp):
    """A box is pushed more and more, by what it can stand at first."""
    model = scene(warp)
    given = {"law": "rft3d", "bodies": "box", "instead_of": ("dunes", "tray")}
    reference = Sand(model, **given, scheme="implicit")
    data = settled(model, reference, 250)
    data.qvel[:] = 0.0
    sand = warp.WarpSand(model, **given)
    m, d = put(model, data.qpos[None], data.qvel[None], sand)
    places = []
    for step in range(300):
        push = np.zeros((1, model.nbody, 6), np.float32)
        push[0, model.body("box").id, 0] = 0.1 * step
        d.xfrc_applied.assign(push)
        data.xfrc_applied[:] = push[0]
        reference.step(data)
        mjw.step(m, d)
        places.append((data.qpos[0], d.qpos.numpy()[0, 0]))
    right, found = (np.array(places) - places[0]).T
    began = [int(np.flatnonzero(x > 1e-4)[0]) for x in (right, found)]
    assert 20 < began[0] < 280
    assert abs(began[1] - began[0]) <= 2
    assert found[-1] == pytest.approx(right[-1], rel=0.02)


FOOT = """
<mujoco>
  <option timestep="{h}" integrator="discrete"/>
  <worldbody>
    <body pos="0 0 -0.035">
      <joint type="slide" axis="0 0 1"/><geom type="box" size="0.05 0.05 0.005" mass="0.5"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("h", [5e-4, 2e-3, 5e-3])
@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_a_foot_lifted_from_rest_pays_for_the_sand_that_moves_along(warp, h):
    """As on the processor, and no step of it, or of the stop after it, gives energy."""
    model = mujoco.MjModel.from_xml_string(FOOT.format(h=h))
    given = {"medium": "quikrete_medium", "law": "rft3d_dynamic"}
    reference = Sand(model, **given, scheme="implicit")
    data = settled(model, reference, 20)
    sand = warp.WarpSand(model, **given)
    m, d = put(model, data.qpos[None], 0 * data.qvel[None], sand)
    for force, seconds in ((100.0, 0.02), (-1000.0, 0.01)):
        data.qfrc_applied[0] = force
        d.qfrc_applied.assign(np.full((1, 1), force, np.float32))
        for _ in range(round(seconds / h)):
            reference.step(data)
            mjw.step(m, d)
            assert sand.power.numpy()[0, 0] <= 0.0
        if force > 0:
            assert d.qvel.numpy()[0, 0] == pytest.approx(data.qvel[0], rel=0.01)
            assert d.qpos.numpy()[0, 0] == pytest.approx(data.qpos[0], rel=0.01)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_what_creeps_is_stopped_under_the_tolerance_of_sleep(warp):
    model = scene(warp)
    given = {"medium": "quikrete_medium", "bodies": "box", "instead_of": ("dunes", "tray")}
    data = settled(model, Sand(model, **given, scheme="implicit"), 250)
    speeds = []
    for tolerance in (model.opt.sleep_tolerance, 0.0):
        model.opt.sleep_tolerance = tolerance
        sand = warp.WarpSand(model, **given)
        m, d = put(model, data.qpos[None], 0 * data.qvel[None], sand)
        for _ in range(50):
            mjw.step(m, d)
        speeds.append(np.abs(d.qvel.numpy()[0, :6]).max())
    assert speeds[0] <= 1e-12 < speeds[1] < 1e-5


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_no_world_is_lost_deep_in_the_sand(warp):
    """Damping is then enormous beside inertia, and both are factorized in single precision."""
    folder = pathlib.Path(gymnasium.envs.mujoco.__file__).parent
    model = mujoco.MjModel.from_xml_path(str(folder / "assets" / "hopper.xml"))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    sand = warp.WarpSand(model, medium="quikrete_medium", instead_of="floor")
    rng = np.random.default_rng(0)
    qpos = np.tile(model.qpos0, (300, 1)) + rng.normal(size=(300, model.nq)) * 0.3
    qpos[:, 1] = rng.uniform(0.0, 1.0, 300)
    qpos[:, 3:] = np.clip(qpos[:, 3:], *(model.jnt_range[3:].T * 0.95))
    m, d = put(model, qpos, rng.normal(size=(300, model.nv)) * 0.01, sand)
    m.opt.warn_overflow = 0
    for _ in range(30):
        mjw.step(m, d)
    assert np.isfinite(d.qpos.numpy()).all()
    assert np.isfinite(d.qvel.numpy()).all()
    assert sand.depth.numpy().max() > 0.5


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_worlds_are_on_their_own(warp):
    """Media, heights, a world that goes bad."""
    import warp as wp

    model = scene(warp)
    sand = warp.WarpSand(
        model, medium="glass_beads", law="rft2d", bodies="box", instead_of=("dunes", "tray")
    )
    m, d = put(model, np.tile(model.qpos0, (4, 1)), np.zeros((4, model.nv)), sand)
    sand.set_media(["glass_beads", "glass_beads", "glass_beads", "poppy_seed_close"])
    sand.height.assign(np.array([0, 0, 0.005, 0], np.float32))
    qvel = d.qvel.numpy()
    qvel[1, 0] = np.nan
    d.qvel.assign(qvel)
    for _ in range(100):
        mjw.step(m, d)
    z = d.qpos.numpy()[:, 2]
    assert np.isfinite(d.qpos.numpy()).all(1).tolist() == [True, False, True, True]
    assert z[0] + 0.005 < z[2] < z[0] + 0.01  # it has fallen less far
    assert abs(z[3] - z[0]) > 1e-4
    assert np.isfinite(z[[0, 2, 3]]).all()
    # The world that went bad starts over.
    mjw.reset_data(m, d, reset=wp.array([False, True, False, False], dtype=bool))
    qpos = d.qpos.numpy()
    qpos[1, 2] = 0.04
    d.qpos.assign(qpos)
    mjw.step(m, d)
    assert np.isfinite(d.qpos.numpy()).all()


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_a_leg_that_turns_about_its_foot_gains_nothing(warp):
    """What rests is damped by 1e8 N s/m, and 6e-8 of that times the speed squared is not little."""
    folder = pathlib.Path(gymnasium.envs.mujoco.__file__).parent
    model = mujoco.MjModel.from_xml_path(str(folder / "assets" / "hopper.xml"))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    sand = warp.WarpSand(model, medium="quikrete_medium", instead_of="floor")
    m, d = put(model, np.tile(model.qpos0, (32, 1)), np.zeros((32, model.nv)), sand)
    rng = np.random.default_rng(0)
    powers, sizes = [], []
    for step in range(200):
        if step % 10 == 0:
            d.ctrl.assign(rng.uniform(-1, 1, (32, model.nu)).astype(np.float32))
        mjw.step(m, d)
        powers.append(sand.power.numpy())
        sizes.append(np.linalg.norm(sand.force.numpy(), axis=-1) * sand.speed.numpy())
    assert np.max(sizes) > 100.0
    assert np.max(powers) <= 1e-6 * np.max(sizes)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_what_is_wrong_is_said(warp):
    model = scene(warp)
    single = mujoco.MjSpec.from_string(SCENE).compile()
    with pytest.raises(InputError, match="leave scheme out"):
        warp.WarpSand(model, medium="quikrete_medium", scheme="explicit")
    with pytest.raises(InputError, match="corrections must be at least 0"):
        warp.WarpSand(model, medium="quikrete_medium", corrections=-1)
    with pytest.raises(InputError, match="MjSpec"):
        warp.coupled(model)
    sand = warp.WarpSand(single, medium="quikrete_medium")
    with pytest.raises(InputError, match="attach the sand first"):
        sand.set_media(["glass_beads"])
    data = mujoco.MjData(single)
    d = mjw.put_data(single, data, nworld=1)
    with pytest.raises(InputError, match=r"'box' as a diagonal.*coupled"):
        sand.attach(mjw.put_model(single), d)
    sand = warp.WarpSand(model, medium="quikrete_medium")
    for name in ("EULER", "RK4", "IMPLICITFAST"):
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name}")
        words = rf"integrator {name.lower()} of MuJoCo Warp has no place.*set.*mjINT_DISCRETE"
        with pytest.raises(InputError, match=words):
            sand.attach(mjw.put_model(model), d)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    other = mujoco.MjModel.from_xml_string(
        '<mujoco><option integrator="discrete"/><worldbody><body><freejoint/>'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(InputError, match="made for another model"):
        sand.attach(mjw.put_model(other), d)
    m = mjw.put_model(model)
    sand.attach(m, d)
    with pytest.raises(InputError, match="attached already"):
        sand.attach(m, d)
    with pytest.raises(InputError, match="each of the 1 worlds"):
        sand.set_media(["quikrete_medium"] * 3)


IN_SAND = {"medium": "quikrete_medium", "bodies": "box", "instead_of": ("dunes", "tray")}


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_models_and_data_must_be_those_of_the_sand(warp):
    """With data of more worlds memory was overwritten; with the others the sand was wrong."""
    with pytest.raises(InputError, match=r"WarpSand takes an MjModel, not 'robot\.xml'"):
        warp.WarpSand("robot.xml")
    model = scene(warp)
    early = mjw.put_model(model)
    sand = warp.WarpSand(model, **IN_SAND)
    d = mjw.put_data(model, mujoco.MjData(model), nworld=2, nconmax=16, njmax=64)
    with pytest.raises(
        InputError, match=r"geom_contype of which differs: make WarpSand first, and then put_model"
    ):
        sand.attach(early, d)
    m = mjw.put_model(model)
    model.geom_size[model.body("box").geomadr] *= 2
    with pytest.raises(InputError, match=r"geom_size of the model was changed after Sand was made"):
        sand.attach(m, d)
    with pytest.raises(InputError, match=r"geom_size.*put_model of the same model"):
        warp.WarpSand(model, **IN_SAND).attach(m, d)
    sand = warp.WarpSand(model, **IN_SAND)
    m = mjw.put_model(model)
    sand.attach(m, d)
    with pytest.raises(InputError, match="another WarpSand acts in this model"):
        warp.WarpSand(model, **IN_SAND).attach(m, d)
    other = mjw.put_data(model, mujoco.MjData(model), nworld=3, nconmax=16, njmax=64)
    with pytest.raises(InputError, match=r"attached to another mujoco_warp\.Data"):
        mjw.step(m, other)
    mjw.step(m, d)
    bit = mujoco.mjtDisableBit
    for flags, words in (
        (bit.mjDSBL_ACTUATION, "actuation"),
        (bit.mjDSBL_SENSOR, "sensors"),
        (bit.mjDSBL_SPRING | bit.mjDSBL_DAMPER, "springs and dampers"),
    ):
        model.opt.disableflags = int(flags)
        with pytest.raises(InputError, match=f"with {words} disabled MuJoCo Warp omits sand"):
            warp.WarpSand(model, **IN_SAND).attach(mjw.put_model(model), d)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_only_geoms_in_the_sand_have_one_shape_in_all_worlds(warp):
    """Worlds may differ in obstacles, goals and markers."""
    import warp as wp

    model = scene(warp)
    d = mjw.put_data(model, mujoco.MjData(model), nworld=2, nconmax=16, njmax=64)
    for body, name in (("rod", "geom_size"), ("rod", "geom_pos"), ("box", "geom_size")):
        sand = warp.WarpSand(model, **IN_SAND)
        m = mjw.put_model(model)
        worlds = np.repeat(getattr(m, name).numpy(), 2, axis=0)
        worlds[1, model.body(body).geomadr] += 0.01
        setattr(m, name, wp.array(worlds, dtype=wp.vec3))
        if body == "rod":
            sand.attach(m, d)
            continue
        with pytest.raises(InputError, match="what meets the sand has one shape in all worlds"):
            sand.attach(m, d)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_sand_has_no_strength_with_gravity_disabled(warp):
    model = scene(warp)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    put_in = {**IN_SAND, "law": "rft3d_dynamic added=0 grain=1e-3"}
    sand, here = warp.WarpSand(model, **put_in), Sand(model, **put_in)
    data = mujoco.MjData(model)
    data.qvel[2] = -1.0
    m, d = put(model, data.qpos[None], data.qvel[None], sand)
    for _ in range(50):
        mjw.step(m, d)
        here.step(data)
    assert data.qpos[2] < 0.04
    np.testing.assert_allclose(d.qpos.numpy()[0, :3], data.qpos[:3], atol=1e-4)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_a_captured_graph_follows_media_that_are_set_later(warp):
    import warp as wp

    model, found = scene(warp), []
    for captured in (False, True):
        sand = warp.WarpSand(model, **{**IN_SAND, "medium": "glass_beads"}, law="rft2d")
        m, d = put(model, np.tile(model.qpos0, (2, 1)), np.zeros((2, model.nv)), sand)
        mjw.step(m, d)
        with wp.ScopedCapture(device="cpu") as capture:
            mjw.step(m, d)
        for media in (["glass_beads", "poppy_seed_close"], "poppy_seed_loose"):
            sand.set_media(media)
            for _ in range(60):
                wp.capture_launch(capture.graph) if captured else mjw.step(m, d)
        found.append(d.qpos.numpy())
    assert abs(found[0][1, 2] - found[0][0, 2]) > 1e-5
    np.testing.assert_array_equal(found[0][:, :3], found[1][:, :3])


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
def test_what_mujoco_warp_refuses_is_said_before(warp):
    spec = mujoco.MjSpec.from_string(SCENE)
    mjgranular.add_sand(spec, medium="quikrete_medium", bodies="box")
    model = spec.compile()
    with pytest.raises(NotImplementedError, match="plugins not supported"):
        mjw.put_model(model)
    with pytest.raises(InputError, match=r"plugin of a body, such as add_sand.*without it"):
        warp.WarpSand(model, medium="quikrete_medium", bodies="box")


@pytest.mark.parametrize("code", ["import mjgranular.warp", "import mjgranular.envs.worlds"])
def test_without_mujoco_warp_there_is_an_install_line(code):
    code = (
        "import sys; sys.modules['mujoco_warp'] = None\n"
        f"import mjgranular\ntry:\n    {code}\n"
        "except mjgranular.MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    line = "needs mujoco_warp, which is not installed: pip install 'mjgranular[warp]'"
    assert done.stdout.strip().endswith(line)
