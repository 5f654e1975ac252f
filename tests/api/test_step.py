"""Stepping: what `Sand.step` and `Sand.apply` do to a simulation besides the force."""

import copy
import gc
import pickle
import subprocess
import sys
import threading
import weakref
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mjgranular import Explicit, InputError, Plane, Sand, UnstableError

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

STEPS = 300
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@pytest.fixture(params=["link", "chain"])
def model(request):
    return request.getfixturevalue(f"{request.param}_model")


def start(model, seed=0):
    """A simulation in the sand, moving, with a user's control and forces."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[1] -= 0.01
    data.qvel[:] += rng.normal(scale=0.5, size=model.nv)
    data.ctrl[:] = 0.3
    data.xfrc_applied[1:] = rng.normal(scale=0.3, size=(model.nbody - 1, 6))
    return data


def state(model, data):
    out = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, out, STATE)
    return out


def run(sand, data, steps=STEPS):
    for _ in range(steps):
        sand.step(data)
    return state(sand.model, data)


def by_hand(sand, data, steps=STEPS):
    model = sand.model
    for _ in range(steps):
        mujoco.mj_step1(model, data)
        sand.apply(data)
        mujoco.mj_step2(model, data)


def arrays(data):
    """Every array of an MjData, by name."""
    named = ((name, getattr(data, name)) for name in dir(data) if not name.startswith("_"))
    return {name: value.copy() for name, value in named if isinstance(value, np.ndarray)}


# What the user writes to xfrc_applied


def test_users_forces_stay_to_the_last_bit(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    own = data.xfrc_applied.copy()
    for _ in range(STEPS):
        sand.step(data)
        assert np.array_equal(data.xfrc_applied, own)
    assert sand.report(data).bodies[0].immersed_length > 0


def test_users_force_acts(link_model):
    # The same force once through xfrc_applied and once as a generalized force.
    sand = Sand(link_model, scheme="explicit")
    one, other = start(link_model), start(link_model)
    one.xfrc_applied[1] = [0.7, 0, 2.0, 0, 0.05, 0]
    other.xfrc_applied[:] = 0
    other.qfrc_applied[:] = [0.7, 2.0, -0.05]  # the hinge turns about -y
    free = start(link_model)
    free.xfrc_applied[:] = 0
    for data in (one, other, free):
        run(sand, data)
    assert one.qpos == pytest.approx(other.qpos, rel=1e-10)
    assert one.qvel == pytest.approx(other.qvel, rel=1e-9)
    assert not np.allclose(one.qpos, free.qpos, rtol=1e-4)


def test_a_row_rewritten_between_two_calls_is_wholly_the_users(model):
    sand, fresh = Sand(model, scheme="explicit"), Sand(model, scheme="explicit")
    data = start(model)
    mujoco.mj_step1(model, data)
    sand.apply(data)
    sand_only = data.xfrc_applied.copy()
    data.xfrc_applied[1] = [1, 2, 3, 4, 5, 6]
    sand.apply(data)
    again = start(model)
    mujoco.mj_step1(model, again)
    again.xfrc_applied[1] = [1, 2, 3, 4, 5, 6]
    fresh.apply(again)
    assert np.array_equal(data.xfrc_applied[1], again.xfrc_applied[1])
    assert np.array_equal(data.xfrc_applied[2:], sand_only[2:])


def test_applying_twice_adds_once(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    mujoco.mj_step1(model, data)
    own = data.xfrc_applied.copy()
    sand.apply(data)
    once = data.xfrc_applied.copy()
    sand.apply(data)
    assert not np.array_equal(once, own)
    assert np.array_equal(data.xfrc_applied, once)


def test_step_after_apply_takes_the_applied_back(model):
    sand, data, other = Sand(model, scheme="explicit"), start(model), start(model)
    own = data.xfrc_applied.copy()
    by_hand(sand, data, 5)
    run(sand, data, 5)
    assert np.array_equal(data.xfrc_applied, own)
    assert np.array_equal(state(model, data), run(sand, other, 10))


# The same numbers in other ways


def test_step_is_step1_apply_step2(model):
    sand = Sand(model, scheme="explicit")
    one, other = start(model), start(model)
    own = one.xfrc_applied.copy()
    run(sand, one)
    by_hand(sand, other)
    other.xfrc_applied[:] = own
    assert np.array_equal(state(model, one), state(model, other))


def test_above_the_sand_it_is_mj_step(model):
    sand = Sand(model, surface=Plane(-5.0), scheme="explicit")
    one, other = start(model), start(model)
    run(sand, one)
    for _ in range(STEPS):
        mujoco.mj_step(model, other)
    assert np.array_equal(state(model, one), state(model, other))


def test_again_after_a_reset(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    expected = run(sand, data)
    for stop in (run, by_hand):
        mujoco.mj_resetData(model, data)
        stop(sand, data, 7)  # leaves a wrench behind, if by hand
        mujoco.mj_resetData(model, data)
        fresh = start(model)
        for name in ("qpos", "qvel", "ctrl", "xfrc_applied"):
            getattr(data, name)[:] = getattr(fresh, name)
        assert np.array_equal(run(sand, data), expected)


def test_a_copied_simulation_goes_on_alike(model):
    sand, data, other = Sand(model, scheme="explicit"), start(model), start(model, seed=1)
    run(sand, data, 50)
    run(sand, other, 20)  # known to the sand already
    mujoco.mj_copyData(other, model, data)
    third = copy.copy(data)
    expected = run(sand, data)
    assert np.array_equal(run(sand, other), expected)
    assert np.array_equal(run(sand, third), expected)


def refilled(model, data):
    """Data of the given model that hold what those of an equal one hold."""
    twin = mujoco.MjData(model)
    mujoco.mj_copyData(twin, model, data)
    return twin


AGAIN = pytest.mark.parametrize(
    "again",
    [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))],
    ids=["deep", "pickle"],
)


@AGAIN
def test_data_that_bring_a_model_of_their_own_are_refused_with_what_to_do(model, again):
    sand, data = Sand(model, scheme="explicit"), start(model)
    run(sand, data, 50)
    twin = again(data)
    assert twin.model is not model
    with pytest.raises(InputError, match=r"a deep copy or a pickle .* mj_copyData; copy\.copy"):
        sand.step(twin)
    expected = run(sand, data)
    assert np.array_equal(run(sand, refilled(model, twin)), expected)


@AGAIN
def test_a_copied_environment_goes_on_alike(model, again):
    env = SimpleNamespace(model=model, data=start(model), sand=Sand(model, scheme="explicit"))
    run(env.sand, env.data, 50)
    twin = again(env)
    assert twin.sand.model is twin.model is not model
    model.opt.gravity[:] = 0.0  # of the copy no more
    again_there = refilled(twin.model, twin.data)
    found = run(twin.sand, again_there)
    model.opt.gravity[:] = twin.model.opt.gravity
    assert np.array_equal(found, run(env.sand, env.data))


def test_a_restored_state_goes_on_alike(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    saved = run(sand, data, 50)
    expected = run(sand, data)
    for again in (data, mujoco.MjData(model)):
        mujoco.mj_setState(model, again, saved, STATE)
        assert np.array_equal(run(sand, again), expected)


@pytest.mark.xfail(reason="a copied row is taken for the user's own", strict=True)
def test_a_copy_between_apply_and_apply_goes_on_alike(model):
    # xfrc_applied is copied with the sand's share in it.
    sand, data, other = Sand(model, scheme="explicit"), start(model), mujoco.MjData(model)
    by_hand(sand, data, 20)
    mujoco.mj_copyData(other, model, data)
    by_hand(sand, data, 20)
    by_hand(sand, other, 20)
    assert np.array_equal(state(model, other), state(model, data))


def test_forward_in_between_changes_nothing(model):
    sand, one, other = Sand(model, scheme="explicit"), start(model), start(model)
    for _ in range(STEPS):
        sand.step(one)
        sand.step(other)
        mujoco.mj_forward(model, other)
    # Contacts, where there are any, warm-start from mj_forward's own solution.
    assert one.qpos == pytest.approx(other.qpos, rel=1e-12, abs=1e-12)


def test_a_second_sand_is_the_same(model):
    assert np.array_equal(
        run(Sand(model, scheme="explicit"), start(model)),
        run(Sand(model, scheme="explicit"), start(model)),
    )


# More than one of each


def test_two_models_interleaved(link_model, chain_model):
    pairs = [(Sand(model, scheme="explicit"), start(model)) for model in (link_model, chain_model)]
    expected = [run(Sand(sand.model, scheme="explicit"), start(sand.model)) for sand, _ in pairs]
    for _ in range(STEPS):
        for sand, data in pairs:
            sand.step(data)
    for (sand, data), alone in zip(pairs, expected, strict=True):
        assert np.array_equal(state(sand.model, data), alone)


def test_two_simulations_interleaved(model):
    sand = Sand(model, scheme="explicit")
    expected = [run(Sand(model, scheme="explicit"), start(model, seed)) for seed in (1, 2)]
    simulations = [start(model, seed) for seed in (1, 2)]
    for _ in range(STEPS):
        for data in simulations:
            sand.step(data)
    for data, alone in zip(simulations, expected, strict=True):
        assert np.array_equal(state(model, data), alone)


def test_two_sands_on_two_bodies_of_one_simulation(chain_model):
    both = Sand(chain_model, bodies=["trunk", "hand"], scheme="explicit")
    trunk, hand = (Sand(chain_model, bodies=name, scheme="explicit") for name in ("trunk", "hand"))
    one, other = start(chain_model), start(chain_model)
    by_hand(both, one)
    for _ in range(STEPS):
        mujoco.mj_step1(chain_model, other)
        trunk.apply(other)
        hand.apply(other)
        mujoco.mj_step2(chain_model, other)
    assert np.array_equal(state(chain_model, one), state(chain_model, other))


def test_simulations_in_threads(model):
    sand, seeds, found, failures = Sand(model, scheme="explicit"), range(6), {}, []
    expected = {seed: run(Sand(model, scheme="explicit"), start(model, seed)) for seed in seeds}

    def work(seed):
        try:
            data = start(model, seed)
            for _ in range(STEPS):
                sand.step(data)
                sand.report(data)
            found[seed] = state(model, data)
        except BaseException as error:  # for the main thread to show
            failures.append(error)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=work, args=(seed,)) for seed in seeds]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not failures
    for seed in seeds:
        assert np.array_equal(found[seed], expected[seed])


# Memory


def test_a_simulation_is_not_kept_alive(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    run(sand, data, 3)
    sand.apply(data)
    sand.report(data)
    alive = weakref.ref(data)
    del data
    gc.collect()
    assert alive() is None


def test_a_new_simulation_at_an_old_address(link_model):
    sand = Sand(link_model, scheme="explicit")
    expected = run(sand, start(link_model))
    seen = set()
    for _ in range(50):
        data = start(link_model)
        reused = id(data) in seen
        seen.add(id(data))
        assert np.array_equal(run(sand, data, STEPS), expected)
        del data
        if reused:
            return
    pytest.skip("no address was used twice")


def test_report_leaves_the_simulation_alone(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    run(sand, data, 20)
    mujoco.mj_forward(model, data)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    full = np.empty(size), np.empty(size)
    mujoco.mj_getState(model, data, full[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    before = arrays(data)
    sand.report(data)
    after = arrays(data)
    mujoco.mj_getState(model, data, full[1], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    assert np.array_equal(*full)
    assert before.keys() == after.keys()
    assert len(before) > 100
    for name, value in before.items():
        assert value.tobytes() == after[name].tobytes(), name


def test_report_is_of_the_state_not_of_what_was_computed_last(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    report = sand.report(data)  # nothing but qpos and qvel has been set
    mujoco.mj_forward(model, data)
    again = sand.report(data)
    for one, other in zip(report.bodies, again.bodies, strict=True):
        assert np.array_equal(one.force, other.force)
        assert np.array_equal(one.moment, other.moment)


def test_reports_do_not_share_memory(link_model):
    sand, data = Sand(link_model, scheme="explicit"), start(link_model)
    run(sand, data)
    first = sand.report(data)
    force = first["link"].force.copy()
    data.qvel[:] = -data.qvel
    sand.report(data)
    assert np.array_equal(first["link"].force, force)


def test_step_allocates_nothing(model):
    sand, data = Sand(model, scheme="explicit"), start(model)
    run(sand, data, 10)
    step, loop = sand.step, range(10_000)
    gc.collect()
    before = sys.getallocatedblocks()
    for _ in loop:
        step(data)
    assert sys.getallocatedblocks() - before < 50


@pytest.mark.slow
def test_making_sand_again_and_again_keeps_nothing(link_model):
    def make():
        gc.collect()
        before = len(gc.get_objects())
        for _ in range(20):
            Sand(link_model, scheme="explicit")
        gc.collect()
        return len(gc.get_objects()) - before

    make()
    assert make() < 100


DEEP_COPY = """
import copy, gc, mujoco, numpy as np
from mjgranular import Sand
from mjgranular.models import Link
sand = Sand(Link().model(1e-4), scheme="explicit")
data = mujoco.MjData(sand.model)
data.qpos[:], data.qvel[:] = (0, 0.05, 0.5), (0, -1, 0)
sand.step(data)
other = mujoco.MjData(sand.model)
mujoco.mj_copyData(other, sand.model, data)
sand.step(other)
again = copy.deepcopy(sand)
twin = mujoco.MjData(again.model)
mujoco.mj_copyData(twin, sand.model, data)
del sand, data
gc.collect()
rubbish = [np.full(size, 7.0) for size in range(1, 60) for _ in range(500)]
again.step(twin)
assert np.array_equal(twin.qpos, other.qpos)
"""


@pytest.mark.slow
def test_a_deep_copy_stands_alone(tmp_path):
    # In a process of its own: addresses of freed memory end one.
    command = [sys.executable, "-c", DEEP_COPY]
    assert subprocess.run(command, cwd=tmp_path, check=False, capture_output=True).returncode == 0


# What may change between two steps


@pytest.mark.parametrize("half_step", [True, False])
def test_a_new_time_step_is_respected(model, half_step):
    scheme = Explicit(half_step=half_step)
    sand, data, other = Sand(model, scheme=scheme), start(model), start(model)
    run(sand, data, 50)
    run(sand, other, 50)
    model.opt.timestep *= 0.5
    time = data.time
    run(sand, data, 50)
    assert data.time == pytest.approx(time + 50 * model.opt.timestep)
    sand.release(other)
    assert np.array_equal(run(Sand(model, scheme=scheme), other, 50), state(model, data))


def test_new_gravity_is_respected(link_model):
    sand, data = Sand(link_model, scheme="explicit"), start(link_model)
    run(sand, data)
    # Static resistance is proportional to it: with the drag out of the way nothing else is left.
    data.qvel[:] = [1e-6, -1e-6, 0]
    force = sand.report(data)["link"].force
    link_model.opt.gravity[2] = -1.62
    assert sand.report(data)["link"].force == pytest.approx(force * 1.62 / 9.81, rel=1e-4)
    other = copy.copy(data)
    assert np.array_equal(run(sand, data), run(Sand(link_model, scheme="explicit"), other))


def test_a_geom_moved_by_the_user_needs_a_new_sand(link_model):
    # Elements are made once, as documented: the model's geoms are read by Sand(...) only.
    data = start(link_model)
    sand = Sand(link_model, scheme="explicit")
    before = sand.report(data)["link"].depth
    link_model.geom("link").pos[2] -= 0.01
    with pytest.raises(InputError, match="geom_pos"):
        sand.report(data)
    assert Sand(link_model, scheme="explicit").report(data)["link"].depth > before


# States that are no numbers


@pytest.fixture
def quiet(monkeypatch, tmp_path):
    """MuJoCo logs bad states to a file in the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("field", ["xpos", "cvel", "xmat"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_force_that_is_no_number_is_not_applied(link_model, field, bad):
    sand, data = Sand(link_model, scheme="explicit"), start(link_model)
    run(sand, data)
    mujoco.mj_step1(link_model, data)
    own = data.xfrc_applied.copy()
    getattr(data, field)[1] = bad
    with pytest.raises(UnstableError, match=r"link.*not finite.*time step below"):
        sand.apply(data)
    assert np.array_equal(data.xfrc_applied, own)


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("field", ["qpos", "qvel"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("autoreset", [False, True])
def test_a_state_that_is_no_number_is_not_stepped(link_model, field, bad, autoreset):
    if not autoreset:
        link_model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    sand, data = Sand(link_model, scheme="explicit"), start(link_model)
    run(sand, data)
    good = state(link_model, data)
    sand.step(data)
    getattr(data, field)[1] = bad
    with pytest.raises(UnstableError, match=f"{field}.*'link'"):
        sand.step(data)
    assert np.array_equal(state(link_model, data), good)
