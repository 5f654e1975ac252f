"""Tunable sand: the same as sand made that way, in every simulation its own."""

from __future__ import annotations

import copy
import math
import pickle
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from mjgranular import (
    Bed,
    DepthVelocityLaw,
    HeightField,
    InputError,
    LinkLaw,
    Plane,
    Rft2dLaw,
    Rft3dLaw,
    UnknownNameError,
    add_sand,
)
from mjgranular.engine import tune
from mjgranular.medium import get_medium

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

ROD = """
<mujoco>
  <option timestep="5e-4"/>
  <asset><hfield name="dunes" nrow="3" ncol="3" size="2 2 0.1 1"
    elevation="0 .2 .4 .1 .5 .3 .2 .6 1"/></asset>
  <worldbody>
    <geom name="dunes" type="hfield" hfield="dunes" pos="0 0 -0.05" euler="5 10 0"/>
    <geom name="tray" type="box" size="2 2 1" pos="0 0 -1"/>
    <body name="rod" pos="0 0 0.02" euler="20 30 0">
      <freejoint/><geom type="capsule" size="0.02 0.1"/>
      <body pos="0 0 -0.1" euler="0 40 0"><joint axis="0 1 0"/>
        <geom type="capsule" size="0.01 0.1" pos="0 0 -0.1"/></body>
    </body>
  </worldbody>
</mujoco>
"""
STEPS = 60
LINK = {"eta_d": 6.5, "eta_h": 8.0, "eta_v": 22.0, "exponent": 1.1}
DEEP = {"constant": 0.3, "stiffness": 20.0, "linear": 0.5, "quadratic": 0.2}


def made(tunable: bool = True, spec: Any = None, **arguments: Any) -> mujoco.MjModel:
    """A jointed rod, with sand."""
    spec = mujoco.MjSpec.from_string(ROD) if spec is None else spec
    if arguments.get("scheme") == "explicit":
        spec.option.timestep = 1e-5
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    add_sand(spec, tunable=tunable, **arguments)
    return spec.compile()


def thrown(model: mujoco.MjModel) -> mujoco.MjData:
    """The rod on its way into the sand."""
    data = mujoco.MjData(model)
    data.qvel[:] = np.linspace(0.3, -1.5, model.nv)
    return data


def end_of(model: mujoco.MjModel, **tuned: float) -> np.ndarray:
    """Where it is `STEPS` later [qpos, qvel]."""
    data = thrown(model)
    if tuned:
        tune(model, data.plugin_state, "sand", **tuned)
    mujoco.mj_step(model, data, STEPS)
    assert not any(warning.number for warning in data.warning)
    return np.concatenate([data.qpos, data.qvel])


def rft3d(**options: float) -> Rft3dLaw:
    return Rft3dLaw(density=1600, internal_friction=0.5, surface_friction=0.3, **options)


def scaled(values: dict[str, float], keys: tuple[str, ...], factor: float) -> dict[str, float]:
    return {key: value * factor if key in keys else value for key, value in values.items()}


CASES: dict[str, tuple[Any, Any, Any]] = {
    "link": (
        LinkLaw(**LINK),
        LinkLaw(**scaled(LINK, ("eta_h", "eta_v"), 0.7)),
        LinkLaw(**scaled(LINK, ("eta_d",), 1.3)),
    ),
    "rft3d": (rft3d(inertia=1.0), rft3d(inertia=1.0, scale=0.7), rft3d(inertia=1.3)),
    "rft2d": (
        Rft2dLaw.generic(1.1, density=1500, inertia=1.0),
        Rft2dLaw.generic(1.1 * 0.7, density=1500, inertia=1.0),
        Rft2dLaw.generic(1.1, density=1500, inertia=1.3),
    ),
    "depth_velocity": (
        DepthVelocityLaw(**DEEP),
        DepthVelocityLaw(**scaled(DEEP, ("constant", "stiffness"), 0.7)),
        DepthVelocityLaw(**scaled(DEEP, ("linear", "quadratic"), 1.3)),
    ),
}


@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
@pytest.mark.parametrize("case", CASES)
def test_strength_and_density_are_those_of_a_law_made_so(case: str, scheme: str) -> None:
    law, weaker, denser = CASES[case]
    model = made(law=law, scheme=scheme)
    plain = made(False, law=law, scheme=scheme)
    np.testing.assert_array_equal(end_of(model), end_of(plain))
    for other, tuned in ((weaker, {"strength": 0.7}), (denser, {"density": 1.3})):
        expected = end_of(made(False, law=other, scheme=scheme))
        assert np.abs(expected - end_of(plain)).max() > 1e-7
        np.testing.assert_allclose(end_of(model, **tuned), expected, rtol=1e-9, atol=1e-12)


def test_a_denser_medium_of_the_link_law_is_both_factors() -> None:
    # All of the link law is proportional to the bulk density; 2 is exact.
    medium = get_medium("play_sand")
    twice = {key: medium.constants_for("link")[key] for key in LINK}
    twice = LinkLaw(**scaled(twice, ("eta_d", "eta_h", "eta_v"), 2.0))
    model = made(law="link")
    np.testing.assert_array_equal(
        end_of(model, strength=2.0, density=2.0), end_of(made(False, law=twice))
    )


def test_height_moves_the_surface_along_its_normal() -> None:
    law, slope, rise = DepthVelocityLaw(**DEEP), 0.2, 0.03
    model = made(law=law, surface=Plane(0.01, slope, 1.0))
    raised = made(False, law=law, surface=Plane(0.01 + rise / math.cos(slope), slope, 1.0))
    np.testing.assert_allclose(end_of(model, height=rise), end_of(raised), atol=1e-13)


@pytest.mark.parametrize("surface", [HeightField("dunes"), Bed("tray")])
def test_height_moves_the_sand_of_a_geom_along_its_own_axis(surface: Any) -> None:
    rise, sand = 0.03, {"law": DepthVelocityLaw(**DEEP), "surface": surface}
    model = made(scheme="explicit", **sand)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    spec = mujoco.MjSpec.from_string(ROD)
    geom = spec.geom(surface.geom)
    geom.pos = np.array(geom.pos) + rise * data.geom(geom.name).xmat.reshape(3, 3)[:, 2]
    raised = made(False, spec, scheme="explicit", **sand)
    np.testing.assert_allclose(end_of(model, height=rise), end_of(raised), atol=1e-12)
    assert np.abs(end_of(model) - end_of(raised)).max() > 1e-5


SENSORS = """
  <sensor>
    <plugin plugin="mjgranular.sensor"><config key="measure" value="force"/></plugin>
    <plugin plugin="mjgranular.sensor"><config key="measure" value="power"/></plugin>
    <plugin plugin="mjgranular.sensor"><config key="measure" value="depth"/></plugin>
  </sensor>
</mujoco>"""


def felt_model() -> mujoco.MjModel:
    """With sensors."""
    known = '<extension><plugin plugin="mjgranular.sensor"/></extension><asset>'
    text = ROD.replace("<asset>", known).replace("</mujoco>", SENSORS)
    return made(spec=mujoco.MjSpec.from_string(text))


@pytest.mark.parametrize("persistent", [False, True])
def test_rows_of_a_batch_do_not_feel_each_others_sand(persistent: bool) -> None:
    batches = pytest.importorskip("mujoco.batch")
    model = felt_model()
    batch = batches.Batch(model, 4, 1, persistent=persistent)
    batch.qvel[:] = thrown(model).qvel
    state, felt = batch.bind("plugin_state"), batch.bind("sensordata")
    tune(model, state, "sand", active=[1, 0, 1, 0])
    for _ in range(3):
        batch.forward()
        assert np.count_nonzero(felt, axis=1).tolist() == [5, 0, 5, 0]
        np.testing.assert_array_equal(felt[0], felt[2])


def test_sand_that_is_switched_off_does_nothing_and_is_not_felt() -> None:
    model, bare = felt_model(), mujoco.MjModel.from_xml_string(ROD)
    bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    np.testing.assert_array_equal(end_of(model, active=0.0), end_of(bare))
    data = thrown(model)
    mujoco.mj_forward(model, data)
    felt = data.sensordata.copy()
    assert np.count_nonzero(felt) == 5
    tune(model, data.plugin_state, "sand", active=0)
    mujoco.mj_forward(model, data)
    assert not data.sensordata.any()
    assert not data.qfrc_passive.any()
    other = mujoco.MjData(model)
    data.plugin_state[0] = 1
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.sensordata, felt)
    # The results of one that is on, in one that was off and is off.
    tune(model, other.plugin_state, "sand", active=0)
    mujoco.mj_forward(model, other)
    mujoco.mj_copyData(other, model, data)
    tune(model, other.plugin_state, "sand", active=0)
    mujoco.mj_forward(model, other)
    assert not other.sensordata.any()


@pytest.mark.slow
def test_the_first_model_of_a_process_begins_as_all_do() -> None:
    code = """
import mujoco, mjgranular
mjgranular._util.display
text = \"\"\"<mujoco><extension><plugin plugin="mjgranular.sand">
  <instance name="sand"><config key="tunable" value="true"/></instance></plugin></extension>
  <worldbody><body><freejoint/><geom type="capsule" size=".1 .1"/></body></worldbody></mujoco>\"\"\"
data = mujoco.MjData(mujoco.MjModel.from_xml_string(text))
print(data.plugin_state.tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "[1.0, 1.0, 1.0, 0.0]\n", done.stderr


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """Two sands: the first has no state."""
    spec = mujoco.MjSpec.from_string(ROD)
    add_sand(spec, law=DepthVelocityLaw(linear=0.01), surface=Plane(-0.3), name="deep")
    return made(spec=spec, law=DepthVelocityLaw(**DEEP))


WAYS = [
    {"strength": 0.5},
    {"density": 2.0, "height": 0.01},
    {"active": 0.0},
    {"strength": 0.0},
    {},
    {"height": -0.05},
    {"strength": 3.0, "density": 0.1, "height": 0.1},
]


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_every_simulation_of_a_batch_has_its_own(
    model: mujoco.MjModel, threads: int, persistent: bool
) -> None:
    batches = pytest.importorskip("mujoco.batch")
    batch = batches.Batch(model, len(WAYS), threads, persistent=persistent)
    state = batch.bind("plugin_state")
    np.testing.assert_array_equal(state, np.tile([1.0, 1.0, 1.0, 0.0], (len(WAYS), 1)))
    batch.qvel[:] = thrown(model).qvel
    for row, way in zip(state, WAYS, strict=True):
        tune(model, row, "sand", **way)
    for _ in range(STEPS // 20):
        batch.step(nstep=20)
    ends = np.concatenate([batch.qpos, batch.qvel], axis=1)
    np.testing.assert_array_equal(ends, [end_of(model, **way) for way in WAYS])
    assert len(np.unique(ends[:, 2])) == len(WAYS)
    batch.reset()
    np.testing.assert_array_equal(state, np.tile([1.0, 1.0, 1.0, 0.0], (len(WAYS), 1)))


def test_all_rows_of_a_batch_at_once(model: mujoco.MjModel) -> None:
    state = np.ones((3, 4))
    tune(model, state, "sand", strength=[1, 2, 3], height=0.5)
    np.testing.assert_array_equal(state, [[1, 1, 1, 0.5], [1, 2, 1, 0.5], [1, 3, 1, 0.5]])


def test_the_state_goes_where_mujocos_goes(model: mujoco.MjModel) -> None:
    way = {"strength": 0.5, "density": 2.0, "height": 0.01}
    expected = end_of(model, **way)
    data = thrown(model)
    tune(model, data.plugin_state, "sand", **way)
    mujoco.mj_step(model, data, STEPS // 2)
    parts = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, parts))
    mujoco.mj_getState(model, data, state, parts)
    others = [mujoco.MjData(model), mujoco.MjData(model)]
    mujoco.mj_setState(model, others[0], state, parts)
    mujoco.mj_copyData(others[1], model, data)
    others += [copy.copy(data), pickle.loads(pickle.dumps(data)), data]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, start, full)
    # The full physics lack the last acceleration, from which solvers start, MuJoCo's and ours.
    states, _ = rollout.rollout(
        model,
        others[0],
        start,
        nstep=STEPS - STEPS // 2,
        initial_warmstart=data.qacc_warmstart.copy(),
    )
    np.testing.assert_array_equal(states[0, -1, 1 : 1 + expected.size], expected)
    mujoco.mj_setState(model, others[0], state, parts)
    for other in others:
        mujoco.mj_step(other.model, other, STEPS - STEPS // 2)
        np.testing.assert_array_equal(np.concatenate([other.qpos, other.qvel]), expected)


def test_a_reset_begins_anew_and_nothing_adds_up(model: mujoco.MjModel) -> None:
    data, expected = thrown(model), end_of(model)
    for strength in (0.3, 1 / 3, 1e-7, 1e7, 0.0):
        tune(model, data.plugin_state, "sand", strength=strength, height=strength)
        mujoco.mj_forward(model, data)
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(data.plugin_state, [1, 1, 1, 0])
    data.qvel[:] = thrown(model).qvel
    mujoco.mj_step(model, data, STEPS)
    np.testing.assert_array_equal(np.concatenate([data.qpos, data.qvel]), expected)


@pytest.mark.parametrize(
    ("number", "value"), [(0, -1.0), (1, math.nan), (1, -0.1), (2, math.inf), (3, -math.inf)]
)
def test_numbers_without_meaning_are_a_bad_state(
    model: mujoco.MjModel, number: int, value: float
) -> None:
    data = thrown(model)
    mujoco.mj_step(model, data, 2)
    data.plugin_state[number] = value
    mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 1
    np.testing.assert_array_equal(data.plugin_state, [1, 1, 1, 0])  # MuJoCo has reset it
    mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all()


def test_wrong_use_is_told(model: mujoco.MjModel) -> None:
    state = mujoco.MjData(model).plugin_state
    with pytest.raises(UnknownNameError, match="deep, sand"):
        tune(model, state, "bed", strength=1)
    with pytest.raises(InputError, match="not tunable: make it with"):
        tune(model, state, "deep", strength=1)
    with pytest.raises(InputError, match="4 numbers"):
        tune(model, np.zeros(5), "sand", strength=1)
    with pytest.raises(InputError, match="strength must be finite and not negative, not -1"):
        tune(model, state, "sand", strength=-1)
    with pytest.raises(InputError, match="height must be finite, not nan"):
        tune(model, state, "sand", density=2, height=math.nan)
    np.testing.assert_array_equal(state, [1, 1, 1, 0])


def test_what_cannot_be_tuned_is_a_load_error(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = mujoco.MjSpec.from_string(ROD)
    add_sand(spec).config = {"tunable": "maybe"}
    with pytest.raises(ValueError, match="config 'tunable': tunable must be true or false"):
        spec.compile()
    for keys in ("strength_keys", "density_keys"):
        monkeypatch.setattr(DepthVelocityLaw, keys, ())
    with pytest.raises(ValueError, match="strength_keys or density_keys"):
        made(law=DepthVelocityLaw(linear=1.25))
