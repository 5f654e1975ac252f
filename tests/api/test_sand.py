"""Several Sands on one simulation; the last good state when a step goes wrong; warnings."""

# pyright: reportPossiblyUnboundVariable=false

import copy
import gc
import types
import warnings

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, GranularWarning, InputError, Sand, UnstableError
from mjgranular.errors import warn_user
from mjgranular.sand.binding import Snapshot, save_snapshot

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def state(model, data):
    out = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, out, STATE)
    return out


def restored(model, saved):
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, saved, STATE)
    return data


# Two Sands on one body


def test_a_second_sand_on_the_same_body_is_refused(chain_model):
    first, second = (
        Sand(chain_model, scheme="explicit"),
        Sand(chain_model, bodies=["hand", "probe"], scheme="explicit"),
    )
    data = mujoco.MjData(chain_model)
    first.step(data)
    before = state(chain_model, data)
    message = r"body 'hand' of this MjData.*an MjData for each.*shared=True.*release\(data\)"
    for call in (second.step, second.apply):
        with pytest.raises(InputError, match=message):
            call(data)
    assert np.array_equal(state(chain_model, data), before)
    first.step(data)  # goes on


def test_a_copy_is_a_second_sand(link_model):
    sand, data = Sand(link_model, scheme="explicit"), mujoco.MjData(link_model)
    sand.step(data)
    with pytest.raises(InputError, match="another Sand acts on body 'link'"):
        copy.copy(sand).step(data)


@pytest.mark.parametrize("shared", [(True, False), (False, True)])
def test_both_have_to_say_so(link_model, shared):
    first, second = (Sand(link_model, shared=each, scheme="explicit") for each in shared)
    data = mujoco.MjData(link_model)
    first.step(data)
    with pytest.raises(InputError, match="make both with shared=True"):
        second.step(data)


def test_what_is_no_second_sand(chain_model):
    data = mujoco.MjData(chain_model)
    first, idle = (
        Sand(chain_model, bodies="arm", scheme="explicit"),
        Sand(chain_model, scheme="explicit"),
    )
    first.step(data)
    idle.report(data)  # looking is not acting
    Sand(chain_model, bodies=["hand", "probe"], scheme="explicit").apply(data)  # other bodies
    Sand(chain_model, scheme="explicit").step(mujoco.MjData(chain_model))  # other data
    Sand(chain_model, scheme="explicit").step(copy.copy(data))
    first.step(data)
    del first
    gc.collect()
    idle.step(data)  # nobody is left


def test_a_released_simulation_can_be_taken_over(link_model):
    first, second = (
        Sand(link_model, scheme="explicit"),
        Sand(link_model, law="link_distributed", scheme="explicit"),
    )
    data = mujoco.MjData(link_model)
    mujoco.mj_resetDataKeyframe(link_model, data, 0)
    data.qpos[1] -= 0.01
    data.xfrc_applied[1] = own = [0.1, 0, 0.2, 0, 0.3, 0]
    mujoco.mj_step1(link_model, data)
    first.release(data)  # nothing yet to let go
    first.apply(data)
    assert not np.array_equal(data.xfrc_applied[1], own)
    first.release(data)
    assert np.array_equal(data.xfrc_applied[1], own)
    second.step(data)
    with pytest.raises(InputError, match="another Sand"):
        first.step(data)
    second.release(data)
    first.step(data)
    assert np.array_equal(data.xfrc_applied[1], own)


def beds():
    """A rod over two beds, which together are a third."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><option timestep="1e-4"/><worldbody>
             <geom name="left" type="box" size="1 1 .5" pos="-1 0 -.5"/>
             <geom name="right" type="box" size="1 1 .5" pos="1 0 -.5"/>
             <geom name="both" type="box" size="2 1 .5" pos="0 0 -.5"/>
             <body name="rod" pos="0 0 -.02">
               <freejoint/>
               <geom type="capsule" fromto="-.2 0 0 .3 .02 .01" size=".01" mass=".3"/>
             </body>
           </worldbody></mujoco>"""
    )
    return spec.compile()


@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_two_beds_side_by_side_are_one(order, scheme):
    """Of the same medium, and cut into pieces none of which is in both."""
    model = beds()
    options = {"law": "rft3d", "medium": "quikrete_medium", "scheme": scheme}
    one = Sand(model, surface=Bed("both"), **options)
    parts = [Sand(model, surface=Bed(name), shared=True, **options) for name in ("left", "right")]
    whole, halves = mujoco.MjData(model), mujoco.MjData(model)
    own = np.array([0.3, 0.1, 0.2, 0.01, 0.02, 0.03])
    for data in (whole, halves):
        data.qvel[:3] = [0.5, 0.1, -1.0]
        data.xfrc_applied[1] = own
    for step in range(40):  # later on, a last bit may decide whether a facet leads
        if step == 20:
            own *= -1
            whole.xfrc_applied[1] = halves.xfrc_applied[1] = own
        one.step(whole)
        mujoco.mj_step1(model, halves)
        for index in order:
            parts[index].apply(halves)
        mujoco.mj_step2(model, halves)
    assert halves.qpos == pytest.approx(whole.qpos, rel=1e-9, abs=1e-12)
    assert halves.qvel == pytest.approx(whole.qvel, rel=1e-7, abs=1e-10)
    parts[0].release(halves)
    assert np.array_equal(halves.xfrc_applied[1], own)  # the other's share goes too, until it acts


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_reports_of_shared_sands_are_their_parts_of_the_force(order):
    """The implicit scheme balances all forces, those of all sands together."""
    model = beds()
    parts = [Sand(model, surface=Bed(name), law="rft3d", shared=True) for name in ("left", "right")]
    data = mujoco.MjData(model)
    model.geom_contype[:] = 0
    data.xfrc_applied[1, 2] = -0.5
    model.opt.timestep = 2e-3
    for _ in range(1500):
        reports = [parts[index].report(data)["rod"] for index in order]
        mujoco.mj_step1(model, data)
        for index in order:
            parts[index].apply(data)
        applied = data.xfrc_applied[1].copy()
        mujoco.mj_step2(model, data)
    total = np.sum([report.force for report in reports], axis=0)
    assert [*total[:2], total[2] - 0.5] == pytest.approx(applied[:3], abs=1e-6)
    assert total[2] == pytest.approx(0.5 + 0.3 * 9.81, rel=1e-9)
    assert np.abs(data.qvel).max() < 1e-9
    _, alone = parts[1].release(data), parts[0].report(data)["rod"]
    assert alone.force[2] > 1.1 * reports[order[0]].force[2]  # half of the rod has lost its sand


@pytest.mark.parametrize("joined", [True, False])
def test_sands_on_parts_of_one_robot_are_solved_together(joined):
    """Without `shared`, since no body meets both; a sand that is not called acts no more."""
    foot = """<body pos="{} 0 0"><joint axis="0 1 0" stiffness="20" damping="1"/>
    <geom type="box" size=".04 .04 .02" mass=".5"/></body>"""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="2e-3" integrator="implicitfast"/><worldbody>
        <body pos="0 0 .01"><freejoint/><geom size=".03" mass="1" pos="0 0 .1"/>
        {foot.format(-0.2)}{foot.format(0.2)}</body></worldbody></mujoco>"""
    )
    one, data, twin = Sand(model), mujoco.MjData(model), mujoco.MjData(model)
    parts = [Sand(model, bodies=[2]), Sand(model, bodies=[3])]
    for _ in range(800):
        one.step(data)
        mujoco.mj_step1(model, twin)
        for part in parts if joined else parts[:1]:
            part.apply(twin)
        mujoco.mj_step2(model, twin)
    if joined:
        assert twin.qpos == pytest.approx(data.qpos, abs=1e-9)
        assert np.abs(twin.qvel).max() < 1e-9
    else:
        assert twin.qpos[2] < data.qpos[2] - 0.1


def made_of_two(model):
    """Make the sand of two halves of a bed, and a firm plane under the explicit scheme."""
    halves = [
        Sand(model, surface=Bed(name), law="rft3d", shared=True) for name in ("left", "right")
    ]
    return [*halves, Sand(model, law="rft3d", scheme="explicit", shared=True)]


def wrench_of(sands, model, data, order):
    mujoco.mj_step1(model, data)
    for index in order:
        sands[index].apply(data)
    return data.xfrc_applied[1].copy()


@pytest.mark.parametrize("before", [(0, 1), (1,), (1, 0), (2, 0, 1)])
@pytest.mark.parametrize("order", [(0, 1), (0, 2, 1), (1,)])
def test_which_sands_acted_in_the_last_step_does_not_matter(before, order):
    """Also not that an explicit one acts between two that are solved together."""
    model = beds()
    model.opt.timestep, model.geom_contype[:] = 1e-3, 0
    data, other = mujoco.MjData(model), mujoco.MjData(model)
    data.qvel[0] = 3.0
    sands = made_of_two(model)
    wrench_of(sands, model, data, (0, 1))
    mujoco.mj_step2(model, data)
    wrench_of(sands, model, data, before)
    mujoco.mj_step2(model, data)
    mujoco.mj_copyState(model, data, other, mujoco.mjtState.mjSTATE_INTEGRATION)
    other.xfrc_applied[:] = 0
    fresh = wrench_of(made_of_two(model), model, other, sorted(order, key=lambda index: index != 2))
    assert wrench_of(sands, model, data, order) == pytest.approx(fresh, rel=1e-6, abs=1e-9)
    assert np.abs(fresh).max() > 0.1


def test_a_sand_whose_step_has_ended_acts_no_more():
    """Two sands from the same state; and one in place of one that is gone."""
    model = beds()
    first, second, _ = made_of_two(model)
    data, alone = mujoco.MjData(model), mujoco.MjData(model)
    first.step(data)
    mujoco.mj_resetData(model, data)
    second.step(data)
    second.step(alone)
    assert np.array_equal(data.qvel, alone.qvel)
    mujoco.mj_resetData(model, data)
    mujoco.mj_step1(model, data)
    first.apply(data)
    second.release(data)
    del first
    gc.collect()
    third = made_of_two(model)[1]
    third.apply(data)
    mujoco.mj_step2(model, data)
    mujoco.mj_copyState(model, data, alone, mujoco.mjtState.mjSTATE_INTEGRATION)
    alone.xfrc_applied[:] = 0
    wrench = wrench_of([third], model, data, (0,))
    assert np.array_equal(wrench, wrench_of([second], model, alone, (0,)))


def test_each_sand_counts_its_steps_once():
    model = beds()
    sands, data = made_of_two(model), mujoco.MjData(model)
    for _ in range(5):
        wrench_of(sands, model, data, (0, 1))
        mujoco.mj_step2(model, data)
    assert [sand.report(data).solver.steps for sand in sands[:2]] == [5, 5]


def test_a_report_takes_the_slope_against_gravity(everything):
    data = mujoco.MjData(everything)
    sand = Sand(everything)

    def slopes():
        found = [standing for body in sand.report(data).bodies for standing in body.validity]
        return [one.value for one in found if one.limit.measure == "slope"]

    assert set(slopes()) <= {0.0, None}
    everything.opt.gravity[:] = 9.81 * np.sin(0.3), 0.0, -9.81 * np.cos(0.3)
    assert set(slopes()) - {None}
    assert all(slope is None or slope == pytest.approx(0.3) for slope in slopes())
    everything.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    assert {body.froude for body in sand.report(data).bodies} == {0.0}


def test_shared_sands_leave_the_users_forces(link_model):
    parts = [
        Sand(link_model, law=law, shared=True, scheme="explicit")
        for law in ("link", "link_distributed")
    ]
    data = mujoco.MjData(link_model)
    mujoco.mj_resetDataKeyframe(link_model, data, 0)
    data.qpos[1] -= 0.01
    data.xfrc_applied[1] = own = [0.1, 0, 0.3, 0, 1 / 3, 0]
    for step in range(50):
        mujoco.mj_step1(link_model, data)
        if step == 20:
            data.xfrc_applied[1] = own = [0.7, 0, 0.1, 0, -1 / 3, 0]
        for sand in parts:
            sand.apply(data)
        mujoco.mj_step2(link_model, data)
    shares = sum(np.concatenate([b.force, b.moment]) for b in _now(parts, data))
    assert data.xfrc_applied[1] - own == pytest.approx(shares, rel=0.05)
    parts[1].release(data)
    assert np.array_equal(data.xfrc_applied[1], own)


def _now(parts, data):
    return [sand.report(data)["link"] for sand in parts]


# The last good state


@pytest.fixture
def everything():
    """A model with something in every part of the state that a model can have."""
    return mujoco.MjModel.from_xml_string(
        """
        <mujoco>
          <option timestep="1e-4"/>
          <size nuserdata="3"/>
          <worldbody>
            <body name="handle" mocap="true" pos="0 0 1"/>
            <body name="hand" pos="0 0 1">
              <freejoint/>
              <geom type="capsule" size=".01 .1"/>
              <body name="arm" pos="0 0 .2">
                <joint name="ball" type="ball"/>
                <geom type="capsule" size=".01 .1"/>
                <body name="tip" pos="0 0 .2">
                  <joint name="tip" damping=".1" axis="0 1 0"/>
                  <geom type="capsule" size=".01 .1"/>
                </body>
              </body>
            </body>
          </worldbody>
          <equality>
            <weld body1="handle" body2="hand"/>
            <connect body1="tip" body2="handle" anchor="0 0 0" active="false"/>
          </equality>
          <actuator>
            <general joint="tip" dyntype="filter" dynprm=".01"/>
            <motor joint="tip" delay=".001" nsample="12"/>
          </actuator>
        </mujoco>"""
    )


def excite(model, data):
    """A state without a zero in it."""
    rng = np.random.default_rng(1)
    data.time = 0.125
    data.ctrl[:] = [0.1, 0.2]
    data.xfrc_applied[:] = rng.normal(scale=0.01, size=data.xfrc_applied.shape)
    data.qfrc_applied[:] = rng.normal(scale=0.01, size=model.nv)
    data.userdata[:] = 1, 2, 3
    data.mocap_pos[0] = 0.01, 0.02, 1.03
    data.mocap_quat[0] = 0.8, 0.6, 0, 0
    data.qvel[:] = rng.normal(scale=0.1, size=model.nv)
    data.eq_active[:] = [False, True]


def test_what_is_kept_is_the_state_of_mujoco(everything):
    sand, data = Sand(everything, law="link", scheme="explicit"), mujoco.MjData(everything)
    excite(everything, data)
    for _ in range(20):
        sand.step(data)
    assert Snapshot(everything, data).time is None
    binding = sand._bindings[data]
    save_snapshot(binding.table)
    saved = state(everything, data)
    assert np.array_equal(binding.snapshot.state, saved)
    mujoco.mj_resetData(everything, data)
    binding.snapshot.restore(everything, data)
    assert np.array_equal(state(everything, data), saved)
    assert binding.snapshot.time == data.time > 0.125


@pytest.fixture
def quiet(monkeypatch, tmp_path):
    """MuJoCo logs bad states to a file in the working directory."""
    monkeypatch.chdir(tmp_path)


def set_autoreset(model, on):
    if not on:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("autoreset", [True, False])
@pytest.mark.parametrize("field", ["qpos", "qvel"])
def test_data_hold_the_last_good_state(everything, field, autoreset):
    """The user spoils the state: that from before the last step is what was good."""
    set_autoreset(everything, autoreset)
    sand, data = Sand(everything, law="link", scheme="explicit"), mujoco.MjData(everything)
    excite(everything, data)
    for _ in range(20):
        good = state(everything, data)
        sand.step(data)
    spoiled = getattr(data, field)
    spoiled[-1] = np.nan
    with pytest.raises(UnstableError, match=rf"{field} of body 'tip' at t = 0\.1269 s:"):
        sand.step(data)
    assert np.array_equal(state(everything, data), good)
    assert data.xpos == pytest.approx(_positions(everything, good), abs=1e-12)
    # The failure is over and done with: what comes next is as if there had been none.
    sand.step(data)
    alone = restored(everything, good)
    Sand(everything, law="link", scheme="explicit").step(alone)
    assert np.array_equal(state(everything, data), state(everything, alone))


def _positions(model, saved):
    data = restored(model, saved)
    mujoco.mj_kinematics(model, data)
    return data.xpos


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("autoreset", [True, False])
def test_a_bad_acceleration_ends_the_step_that_has_it(everything, autoreset):
    set_autoreset(everything, autoreset)
    sand, data = Sand(everything, law="link", scheme="explicit"), mujoco.MjData(everything)
    excite(everything, data)
    for _ in range(5):
        sand.step(data)
    data.qfrc_applied[7] = np.inf
    before = state(everything, data)
    with pytest.raises(UnstableError, match=r"qacc of body '(hand|arm|tip)' at t = 0\.1255 s"):
        sand.step(data)
    assert np.array_equal(state(everything, data), before)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize(
    ("index", "body"),
    [
        (0, "trunk"),
        (3, "trunk"),
        (6, "trunk"),
        (7, "arm"),
        (8, "hand"),
        (11, "hand"),
        (12, "probe"),
    ],
)
def test_the_body_is_named_by_position(chain_model, index, body):
    """Free and ball joints have more positions than velocities."""
    sand, data = Sand(chain_model, scheme="explicit"), mujoco.MjData(chain_model)
    sand.step(data)
    data.qpos[index] = np.inf
    with pytest.raises(UnstableError, match=f"qpos of body '{body}' at t = 0 s:"):
        sand.step(data)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize(
    ("index", "body"), [(0, "trunk"), (5, "trunk"), (6, "arm"), (7, "hand"), (10, "probe")]
)
def test_the_body_is_named_by_velocity(chain_model, index, body):
    sand, data = Sand(chain_model, scheme="explicit"), mujoco.MjData(chain_model)
    sand.step(data)
    data.qvel[index] = 1e11
    with pytest.raises(UnstableError, match=f"qvel of body '{body}'"):
        sand.step(data)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("autoreset", [True, False])
def test_nothing_good_was_known(link_model, autoreset):
    set_autoreset(link_model, autoreset)
    sand, data = Sand(link_model, scheme="explicit"), mujoco.MjData(link_model)
    data.qvel[2] = np.nan
    with pytest.raises(UnstableError) as caught:
        sand.step(data)
    message = str(caught.value)
    assert "qvel of body 'link' before the sand's first step" in message
    assert ("has reset the simulation" in message) is autoreset
    data.qvel[2] = 0
    sand.step(data)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("autoreset", [True, False])
def test_apply_brings_the_state_back_too(everything, autoreset):
    set_autoreset(everything, autoreset)
    sand, data = Sand(everything, law="link", scheme="explicit"), mujoco.MjData(everything)
    excite(everything, data)
    own = data.xfrc_applied.copy()
    for _ in range(20):
        good = data.time, data.qpos.copy(), data.qvel.copy(), data.mocap_pos.copy()
        mujoco.mj_step1(everything, data)
        sand.apply(data)
        mujoco.mj_step2(everything, data)
    data.qvel[3] = np.nan
    mujoco.mj_step1(everything, data)
    with pytest.raises(UnstableError, match="qvel of body 'hand'"):
        sand.apply(data)
    for found, expected in zip(
        (data.time, data.qpos, data.qvel, data.mocap_pos), good, strict=True
    ):
        assert np.array_equal(found, expected)
    sand.release(data)
    # What MuJoCo has reset stays so; what it has not is the user's.
    assert np.array_equal(data.xfrc_applied, 0 * own if autoreset else own)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("autoreset", [True, False])
def test_a_run_that_blows_up_of_itself(everything, autoreset):
    set_autoreset(everything, autoreset)
    everything.dof_damping[-1] = -10
    sand, data = Sand(everything, law="link", scheme="explicit"), mujoco.MjData(everything)
    excite(everything, data)
    time, failed = 0.0, None
    while failed is None:
        time = data.time
        try:
            sand.step(data)
        except UnstableError as error:
            failed = str(error)
    assert f"at t = {data.time:.6g} s: " in failed
    assert "time step below 0.0001 s" in failed
    assert time - 1.5e-4 < data.time <= time
    assert np.isfinite(state(everything, data)).all()
    assert 1e3 < np.abs(data.qvel).max() < 1e10


# Warnings


def module(name, source):
    """A module of that name, as if it had been imported from a file of it."""
    made = types.ModuleType(name)
    vars(made)["warn_user"] = warn_user
    exec(compile(source, f"{name}.py", "exec"), vars(made))
    return made


@pytest.mark.parametrize("depth", [0, 1, 5])
def test_warnings_point_at_the_users_line(depth):
    source = "def dig(depth):\n    return dig(depth - 1) if depth else warn_user('mind this')"
    inner = module("mjgranular.inner", source)
    outer = module("mjgranular_user", "def use(dig, depth):\n\n    dig(depth)")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        outer.use(inner.dig, depth)
    (warning,) = caught
    assert warning.category is GranularWarning
    assert str(warning.message) == "mind this"
    assert (warning.filename, warning.lineno) == ("mjgranular_user.py", 3)


@pytest.mark.parametrize("library", ["functools", "contextlib", "gymnasium.envs.registration"])
def test_warnings_point_beyond_what_calls_this_package_for_the_user(library):
    inner = module("mjgranular.inner", "def dig(_):\n    warn_user('mind this')")
    between = module(library, "def make(dig):\n    dig(0)")
    user = module("user", "def use(make, dig):\n\n    make(dig)")
    with pytest.warns(GranularWarning) as caught:
        user.use(between.make, inner.dig)
    assert (caught[0].filename, caught[0].lineno) == ("user.py", 3)
