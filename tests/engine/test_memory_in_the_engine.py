"""Sand that remembers inside `mj_step`: its heights are a part of MuJoCo's state."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from mjgranular import InputError, Memory, Plane, Rft3dLaw, Sand, add_sand
from mjgranular.engine import relief_of
from mjgranular.relief.grid import HEADER, TIME

LAW = Rft3dLaw(density=1600, internal_friction=0.5, surface_friction=0.3)
MEMORY = Memory(cell=0.01, extent=0.6)
BALLS = """
<mujoco>
  <option timestep="1e-3" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 0.06"><freejoint/><geom type="sphere" size="0.025" mass="0.5"/></body>
    <body pos="0.2 0 0.1"><freejoint/><geom type="sphere" size="0.02" mass="0.3"/></body>
  </worldbody>
</mujoco>
"""


def made(**options: Any) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(BALLS)
    if options.get("scheme") == "explicit":
        spec.option.timestep = 1e-4
    add_sand(spec, **({"law": LAW, "memory": MEMORY} | options))
    return spec.compile()


def thrown(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qvel[:] = 0.4, 0.1, -1.0, 0, 1, 0, -0.3, 0, -0.5, 1, 0, 0
    return data


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def test_both_interfaces_remember_the_same() -> None:
    model = made()
    data = thrown(model)
    plain = mujoco.MjModel.from_xml_string(BALLS)
    sand, other = Sand(plain, law=LAW, memory=MEMORY), mujoco.MjData(plain)
    other.qvel[:] = data.qvel
    mujoco.mj_step(model, data, 300)
    for _ in range(300):
        sand.step(other)
    np.testing.assert_allclose(data.qpos, other.qpos, rtol=0, atol=1e-9)
    inside, outside = relief_of(model, data), sand.relief(other)
    np.testing.assert_array_equal(inside.x, outside.x)
    np.testing.assert_allclose(inside.height, outside.height, rtol=0, atol=1e-9)
    assert inside.height.min() < -0.01


def test_same_motion_leaves_the_same_heights_to_the_last_bit() -> None:
    """Led along a path, which takes the rounding of MuJoCo's own sums out."""
    model = made(scheme="explicit")
    data = mujoco.MjData(model)
    plain = mujoco.MjModel.from_xml_string(BALLS)
    plain.opt.timestep = model.opt.timestep
    sand, other = Sand(plain, law=LAW, memory=MEMORY, scheme="explicit"), mujoco.MjData(plain)
    for k in range(300):
        for one in (data, other):
            one.qpos[:3] = 0.0003 * k, 0.0001 * k, 0.03 - 0.0002 * k
            one.qvel[:] = 0.0
        mujoco.mj_step(model, data)
        sand.step(other)
    state = sand._bindings[other].state.copy()
    state[TIME] = 0.0
    np.testing.assert_array_equal(data.plugin_state, state)


def test_state_is_copied_saved_restored_and_reset() -> None:
    model = made()
    data = thrown(model)
    mujoco.mj_step(model, data, 150)
    assert data.plugin_state[HEADER:].any()
    kept = state_of(model, data)
    copies = [copy.copy(data), pickle.loads(pickle.dumps(data)), mujoco.MjData(model)]
    mujoco.mj_setState(model, copies[-1], kept, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_step(model, data, 150)
    end = state_of(model, data)
    for one in copies:
        mujoco.mj_step(model, one, 150)
        np.testing.assert_array_equal(state_of(model, one), end)
    mujoco.mj_resetData(model, data)
    assert not data.plugin_state.any()
    assert not relief_of(model, data).height.any()


def test_rollouts_go_on_alike() -> None:
    model = made()
    data = thrown(model)
    mujoco.mj_step(model, data, 100)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, initial, kind)
    warmstart = data.qacc_warmstart.copy()
    states, _ = rollout.rollout(
        model, mujoco.MjData(model), initial, nstep=50, initial_warmstart=warmstart
    )
    mujoco.mj_step(model, data, 50)
    end = np.zeros_like(initial)
    mujoco.mj_getState(model, data, end, kind)
    np.testing.assert_array_equal(states[0, -1], end)


def test_threads_of_rollouts_and_batches_remember_alike() -> None:
    """As single simulations do, to the last bit, on any number of threads."""
    batch_module = pytest.importorskip("mujoco.batch", reason="a MuJoCo without batches")
    model = made()
    singles, speeds = [], (0.0, 0.5, -0.5, 0.9)
    for speed in speeds:
        data = thrown(model)
        data.qvel[0] = speed
        singles.append(data)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = np.zeros((len(speeds), mujoco.mj_stateSize(model, kind)))
    for row, data in zip(initial, singles, strict=True):
        mujoco.mj_getState(model, data, row, kind)
    pool = [mujoco.MjData(model) for _ in range(2)]
    warm = np.zeros((len(speeds), model.nv))
    states, _ = rollout.rollout(model, pool, initial, nstep=200, initial_warmstart=warm)
    ends = np.zeros_like(initial)
    for end, data in zip(ends, singles, strict=True):
        mujoco.mj_step(model, data, 200)
        mujoco.mj_getState(model, data, end, kind)
    np.testing.assert_array_equal(states[:, -1], ends)
    for persistent in (False, True):
        batch = batch_module.Batch(model, len(speeds), 2, persistent=persistent)
        qvel, remembered = batch.bind("qvel"), batch.bind("plugin_state")
        for row, speed in zip(qvel, speeds, strict=True):
            row[:] = thrown(model).qvel
            row[0] = speed
        for _ in range(4):
            batch.step(nstep=50)
        for row, state, data in zip(batch.bind("qpos"), remembered, singles, strict=True):
            np.testing.assert_array_equal(row, data.qpos)
            np.testing.assert_array_equal(state, data.plugin_state)
        batch.reset(ids=[1, 3])
        assert not remembered[[1, 3]].any()
        assert remembered[0].any()


def test_what_sleeps_leaves_the_sand_alone() -> None:
    """A ball on a floor in the sand falls asleep in its print, which stays as it is."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><option integrator="implicitfast"><flag sleep="enable"/></option><worldbody>
        <geom name="floor" type="plane" size="1 1 1"/>
        <body name="ball" pos="0 0 0.08"><freejoint/><geom type="sphere" size="0.05"/></body>
        <body name="other" pos="0.5 0 1"><freejoint/><geom type="sphere" size="0.05"/></body>
        </worldbody></mujoco>"""
    )
    add_sand(spec, law=LAW, surface=Plane(0.02), memory=Memory(extent=1.0))
    model = spec.compile()
    data, ball = mujoco.MjData(model), model.body("ball").id
    for _ in range(2000):
        mujoco.mj_step(model, data)
        if data.body_awake[ball] == 0:
            break
    assert data.body_awake[ball] == 0
    about = {"middle": (0.0, 0.0)}
    mujoco.mj_step(model, data, 300)  # walls come to rest
    before = relief_of(model, data, **about).height
    middle = np.abs(np.arange(100) - 50) < 20
    assert before[np.ix_(middle, middle)].min() < -0.005
    mujoco.mj_step(model, data, 300)
    assert data.body_awake[ball] == 0
    after = relief_of(model, data, **about).height
    np.testing.assert_allclose(after[middle][:, middle], before[middle][:, middle], atol=1e-4)


def test_numbers_that_are_none_in_the_heights_are_left_to_mujoco() -> None:
    """It warns and resets, as with any bad state; then the sand is untouched."""
    model = made()
    data = thrown(model)
    mujoco.mj_step(model, data, 150)
    data.plugin_state[HEADER:] = math.nan
    mujoco.mj_step(model, data, 100)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number >= 1
    assert np.isfinite(data.plugin_state).all()


def test_forward_does_not_change_what_is_remembered() -> None:
    model = made()
    data = thrown(model)
    mujoco.mj_step(model, data, 150)
    before, force = data.plugin_state.copy(), None
    for _ in range(3):
        mujoco.mj_forward(model, data)
        force = data.qfrc_passive.copy() if force is None else force
        np.testing.assert_allclose(data.qfrc_passive, force, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(data.plugin_state, before)


def test_two_sands_have_a_memory_each() -> None:
    spec = mujoco.MjSpec.from_string(BALLS)
    bodies = [body.name or str(number) for number, body in enumerate(spec.bodies)][1:]
    add_sand(spec, law=LAW, memory=MEMORY, bodies=bodies[:1], name="first")
    add_sand(spec, law=LAW, memory=0.02, bodies=bodies[1:], name="second")
    model = spec.compile()
    data = thrown(model)
    mujoco.mj_step(model, data, 300)
    first, second = (relief_of(model, data, name) for name in ("first", "second"))
    assert first.height.shape == (60, 60)
    assert second.height.shape == (100, 100)
    assert first.height.min() < 0.0
    assert second.height.min() < 0.0


def test_nothing_is_kept_without_memory() -> None:
    assert made(memory=None).npluginstate == 0
    assert made(memory=True).npluginstate == Memory().state_size


@pytest.mark.parametrize("words", ["0.01", "cell=0.01 extent=0.6", "true"])
def test_words_in_mjcf(words: str) -> None:
    model = mujoco.MjModel.from_xml_string(
        BALLS.replace(
            "<worldbody>",
            '<extension><plugin plugin="mjgranular.sand"><instance name="sand">'
            f'<config key="memory" value="{words}"/></instance></plugin></extension><worldbody>',
        )
    )
    mujoco.MjData(model)
    assert model.npluginstate == Memory(extent=0.6 if "=" in words else 2.0).state_size


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("cell=0", "the memory's cell must be a number above 0, not 0.0"),
        ("big", "must be a number, not 'big'"),
        ("cells=1", "the memory has no option 'cells'; it has: cell, extent"),
    ],
)
def test_words_without_meaning_are_refused(words: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        made(memory=words)


def test_memory_and_tunable_exclude_each_other() -> None:
    spec = mujoco.MjSpec.from_string(BALLS)
    with pytest.raises(InputError, match="sand with memory cannot be tunable"):
        add_sand(spec, law=LAW, memory=True, tunable=True)


def test_nonsense_in_the_state_leads_nowhere() -> None:
    """Whoever writes into `plugin_state` finds MuJoCo's own warning, and no crash."""
    model = made(surface=Plane())
    rng = np.random.default_rng(0)
    for value in (math.nan, 1e300, -1e300, None):
        data = thrown(model)
        mujoco.mj_step(model, data, 60)
        noise = rng.normal(scale=1e6, size=model.npluginstate)
        data.plugin_state[:] = noise if value is None else value
        mujoco.mj_step(model, data, 20)
        assert np.isfinite(data.qpos).all()
