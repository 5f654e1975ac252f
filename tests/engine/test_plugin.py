"""The engine door: the same numbers as `Sand.step`, everywhere that MuJoCo steps."""

# pyright: reportAbstractUsage=false, reportPrivateImportUsage=false, reportMissingImports=false

from __future__ import annotations

import copy
import gc
import pickle
import subprocess
import sys
import threading
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from mjgranular import (
    Bed,
    DepthVelocityLaw,
    Explicit,
    HeightField,
    InputError,
    LinkLaw,
    Medium,
    Plane,
    Quantity,
    Sand,
    Surface,
    add_sand,
    laws,
    register_law,
)
from mjgranular.engine import NAME, pickles, tune
from mjgranular.engine.config import KEYS, SENSOR, SENSOR_KEYS
from mjgranular.engine.instances import sands_in
from mjgranular.errors import FloorWarning
from mjgranular.models import Link
from mjgranular.surface import surfaces

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

STEPS = 300

TWO_BEDS = """
<mujoco>
  <option timestep="1e-4"/>
  <worldbody>
    <geom name="left" type="box" pos="-1 0 -0.2" size="0.5 0.5 0.2"/>
    <geom name="right" type="box" pos="1 0 -0.2" size="0.5 0.5 0.2"/>
    <body name="a" pos="-1 0 0"><freejoint/><geom type="sphere" size="0.05"/></body>
    <body name="b" pos="1 0 0"><freejoint/><geom type="sphere" size="0.05"/></body>
  </worldbody>
</mujoco>
"""

ON_A_FLOOR = """
<mujoco>
  <option><flag sleep="enable"/></option>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="ball" pos="0 0 0.05"><freejoint/><geom type="sphere" size="0.05"/></body>
  </worldbody>
</mujoco>
"""


def sandy_link(**arguments: Any) -> mujoco.MjModel:
    """The paper's link with sand in the model, at 1e-5 s."""
    spec = Link().spec()
    add_sand(spec, **arguments)
    return spec.compile()


def released(model: mujoco.MjModel) -> mujoco.MjData:
    """The link at 10 m/s with its end on the sand."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("impact").id)
    return data


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return sandy_link()


@pytest.fixture(scope="module")
def landed(model: mujoco.MjModel) -> np.ndarray:
    """`qpos` after `STEPS` steps."""
    data = released(model)
    mujoco.mj_step(model, data, STEPS)
    return data.qpos.copy()


def random_tree(seed: int) -> mujoco.MjSpec:
    """Bodies on all kinds of joints, half of them in the sand, moving."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    spec.option.timestep = 1e-3
    spec.option.gravity = rng.normal([0, 0, -9.81])
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    field = spec.add_hfield(name="dunes", nrow=7, ncol=9, size=[3, 3, 0.4, 0.1])
    field.userdata = rng.uniform(size=63)
    kinds = mujoco.mjtGeom
    spec.worldbody.add_geom(name="dunes", type=kinds.mjGEOM_HFIELD, hfieldname="dunes")
    spec.worldbody.add_geom(
        name="tray", type=kinds.mjGEOM_BOX, size=[2, 2, 1], pos=[0, 0, -1], euler=[0.1, -0.1, 1]
    )
    joints = [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL]
    bodies = [spec.worldbody]
    for number in range(6):
        parent = bodies[rng.integers(len(bodies))]
        body = parent.add_body(
            name=f"body{number}", pos=0.3 * rng.normal(size=3), quat=rng.normal(size=4)
        )
        if parent is spec.worldbody and rng.random() < 0.5:
            body.add_freejoint()
        else:
            for kind in ((0,), (1,), (2,), (0, 1), (1, 2))[rng.integers(5)]:
                body.add_joint(type=joints[kind], axis=rng.normal(size=3))
        for kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
            body.add_geom(
                type=kind,
                group=int(kind == kinds.mjGEOM_CAPSULE) + number % 2 * 2,
                size=[*rng.uniform(0.02, 0.1, size=2), 0],
                pos=0.1 * rng.normal(size=3),
                quat=rng.normal(size=4),
            )
        bodies.append(body)
    return spec


def stir(model: mujoco.MjModel, data: mujoco.MjData, seed: int) -> None:
    """Puts the simulation into a random state."""
    rng = np.random.default_rng(seed)
    mujoco.mj_resetData(model, data)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 0.3)
    data.qvel[:] = rng.normal(size=model.nv)
    data.qacc_warmstart[:] = rng.normal(size=model.nv)
    data.xfrc_applied[:] = rng.normal(size=(model.nbody, 6))


SANDS: list[dict[str, Any]] = [
    {},
    {"law": "link_distributed", "scheme": Explicit(half_step=False), "resolution": 7},
    {"medium": "quikrete_medium"},
    {"law": "rft3d", "medium": "quikrete_medium", "surface": Bed("tray"), "scheme": "explicit"},
    {"law": "rft3d", "medium": "quikrete_medium", "surface": HeightField("dunes")},
    {"law": DepthVelocityLaw(constant=1, stiffness=40, quadratic=3), "surface": Plane(0.1, 0.2, 1)},
    {"law": LinkLaw(7.0, 0.1 + 0.2, 9, 1 / 3), "bodies": ["body1", "body4"], "groups": 3},
    {"law": "link_distributed", "scheme": "implicit"},
]


@pytest.mark.filterwarnings("ignore:robot .* is buried:mjgranular.GranularWarning")
@pytest.mark.parametrize("arguments", SANDS, ids=lambda arguments: "-".join(arguments) or "plain")
@pytest.mark.parametrize(
    "integrator", ["mjINT_EULER", pytest.param("mjINT_IMPLICITFAST", marks=pytest.mark.slow)]
)
def test_both_doors_give_the_same_force(arguments: dict[str, Any], integrator: str) -> None:
    for seed in range(3 if integrator == "mjINT_EULER" else 1):
        spec = random_tree(seed)
        spec.option.integrator = getattr(mujoco.mjtIntegrator, integrator)
        bare = mujoco.MjModel.from_xml_string(spec.to_xml())  # XML rounds: once for both
        add_sand(spec, **arguments)
        sandy = mujoco.MjModel.from_xml_string(spec.to_xml())
        mine, theirs = mujoco.MjData(sandy), mujoco.MjData(bare)
        sand = Sand(bare, **arguments)
        for state in range(4):
            stir(sandy, mine, state)
            stir(bare, theirs, state)
            before = mine.xfrc_applied.copy()
            mujoco.mj_step(sandy, mine)
            sand.step(theirs)
            assert np.abs(theirs.qacc).max() < 1e9
            scale = np.abs(theirs.qacc).max()
            np.testing.assert_allclose(mine.qacc, theirs.qacc, rtol=1e-12, atol=1e-12 * scale)
            np.testing.assert_allclose(mine.qvel, theirs.qvel, rtol=1e-12, atol=1e-15 * scale)
            np.testing.assert_array_equal(mine.xfrc_applied, before)


def test_a_whole_fall_is_the_same(model: mujoco.MjModel, link_model: mujoco.MjModel) -> None:
    mine, theirs = released(model), released(link_model)
    sand = Sand(link_model)
    for _ in range(2000):
        mujoco.mj_step(model, mine)
        sand.step(theirs)
    np.testing.assert_allclose(mine.qpos, theirs.qpos, rtol=1e-12)
    np.testing.assert_allclose(mine.qvel, theirs.qvel, rtol=1e-12)


def test_sand_is_in_qfrc_passive_and_nothing_else_is_touched(model: mujoco.MjModel) -> None:
    data = released(model)
    mujoco.mj_step(model, data, 2)
    assert np.any(data.qfrc_passive)
    assert not np.any(data.xfrc_applied)
    assert not np.any(data.qfrc_applied)


@pytest.mark.parametrize("scheme", ["auto", "implicit", "explicit"])
def test_runge_kutta_is_refused(scheme: str) -> None:
    spec = Link().spec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = 2e-3
    add_sand(spec, scheme=scheme)
    with pytest.raises(ValueError, match="set the model's integrator to Euler"):
        mujoco.MjData(spec.compile())


def test_two_media_in_two_beds() -> None:
    spec = mujoco.MjSpec.from_string(TWO_BEDS)
    add_sand(spec, law=DepthVelocityLaw(stiffness=100), surface=Bed("left"))
    add_sand(spec, law=DepthVelocityLaw(stiffness=300), surface=Bed("right"))
    model = spec.compile()
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_PLUGIN, i) for i in range(2)]
    assert names == ["sand", "sand_2"]
    data = mujoco.MjData(model)
    data.qvel[[2, 8]] = -1
    mujoco.mj_forward(model, data)
    assert data.ncon == 0  # beds are no obstacles
    assert data.qfrc_passive[8] == pytest.approx(3 * data.qfrc_passive[2])
    assert data.qfrc_passive[2] == pytest.approx(100 * 0.05)


def test_a_bed_beside_does_not_count_as_ground() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody>
        <geom name="left" type="box" size=".5 .5 .2" pos="-.5 0 -.2"/>
        <geom name="right" type="box" size=".5 .5 .2" pos=".5 0 -.2"/>
        <body pos="0 0 .1"><freejoint/><geom type="box" size=".05 .05 .05" mass="2"/></body>
        </worldbody></mujoco>"""
    )
    for side in ("left", "right"):
        add_sand(spec, surface=Bed(side))
    with warnings.catch_warnings():
        warnings.simplefilter("error", FloorWarning)
        mujoco.MjData(spec.compile())


def test_sands_of_a_model_are_told() -> None:
    spec = mujoco.MjSpec.from_string(TWO_BEDS)
    assert sands_in(spec.compile()) == ()
    for side in ("left", "right"):
        add_sand(spec, law=DepthVelocityLaw(linear=1.0), surface=Bed(side))
    assert sands_in(spec.compile()) == ("sand", "sand_2")


def test_sand_beside_sand_of_the_models_own_is_refused() -> None:
    spec = mujoco.MjSpec.from_string(TWO_BEDS)
    law = DepthVelocityLaw(linear=1.0)
    add_sand(spec, law=law, surface=Bed("left"), bodies="a")
    model = spec.compile()
    with pytest.raises(InputError, match=r"instance 'sand', which acts on body 'a' .*shared=True"):
        Sand(model, law=law, surface=Bed("right"))
    Sand(model, law=law, surface=Bed("right"), bodies="b").step(mujoco.MjData(model))
    both, data = Sand(model, law=law, surface=Bed("right"), shared=True), mujoco.MjData(model)
    both.step(data)
    both.report(data)


def test_what_is_written_survives_xml_copy_and_attach() -> None:
    spec = Link().spec()
    law = LinkLaw(6.5, 0.1 + 0.2, 22, 1.1)
    add_sand(spec, medium="play_sand", law=law, surface=Plane(0.01), resolution=3)
    model = spec.compile()
    text = spec.to_xml()
    again = mujoco.MjSpec.from_string(text, assets=_assets())
    (plugin,) = again.plugins
    assert plugin.config == {
        "medium": "play_sand",
        "law": "link eta_d=6.5 eta_h=0.30000000000000004 eta_v=22 exponent=1.1",
        "surface": "plane height=0.01 slope=0.0 uphill=0.0",
        "scheme": "auto",
        "draw": "surface",
        "resolution": "3",
    }
    parent = mujoco.MjSpec()
    parent.attach(again.copy(), frame=parent.worldbody.add_frame())
    with pytest.warns(UserWarning, match="timestep: parent has"):
        attached = parent.compile()
    ends = []
    for other in (model, again.compile(), again.copy().compile(), attached):
        assert other.nplugin == 1
        data = mujoco.MjData(other)
        data.qpos[1], data.qvel[1] = 0.05, -1
        other.opt.timestep = 1e-5
        mujoco.mj_step(other, data, STEPS)
        ends.append(data.qpos.copy())
    np.testing.assert_allclose(ends[1:], ends[:1] * 3, rtol=1e-6)  # XML rounds masses


EMPTY_BEDS = """<mujoco><worldbody>
    <geom name="left" type="box" size=".5 .5 .2" pos="-.5 0 -.2"/>
    <geom name="right" type="box" size=".5 .5 .2" pos=".5 0 -.2"/>
    </worldbody></mujoco>"""
LONE_BOX = """<mujoco><worldbody><body name="base" pos="0 0 .1"><freejoint/>
    <geom type="box" size=".05 .05 .05"/></body></worldbody></mujoco>"""


def _arena(sands: int, *, robots_first: bool) -> mujoco.MjSpec:
    """Return beds and two robots, which are attached before or after that many sands are added."""
    spec = mujoco.MjSpec.from_string(EMPTY_BEDS)

    def attach() -> None:
        for prefix in ("a/", "b/"):
            robot = mujoco.MjSpec.from_string(LONE_BOX)
            spec.attach(robot, prefix=prefix, frame=spec.worldbody.add_frame())

    if robots_first:
        attach()
    for side in ("left", "right")[:sands]:
        add_sand(spec, surface=Bed(side))
    if not robots_first:
        attach()
    return spec


@pytest.mark.parametrize("robots_first", [True, False])
def test_sand_stays_when_a_robot_is_deleted(robots_first: bool) -> None:
    for change in (lambda spec: spec.delete(spec.body("a/base")), lambda spec: None):
        spec = _arena(1, robots_first=robots_first)
        change(spec)
        again = mujoco.MjSpec.from_string(spec.to_xml())
        for other in (spec, spec.copy(), again, again.copy()):
            assert sands_in(other.compile()) == ("sand",)


def test_two_sands_around_one_robot_survive_a_copy() -> None:
    spec = _arena(0, robots_first=True)
    spec.delete(spec.body("b/base"))
    for side in ("left", "right"):
        add_sand(spec, surface=Bed(side))
    assert sands_in(spec.copy().compile()) == ("sand", "sand_2")


def test_static_bodies_are_fused_as_without_sand() -> None:
    post = '<compiler fusestatic="true"/><worldbody><body><geom size=".1"/></body>'
    spec = mujoco.MjSpec.from_string(LONE_BOX.replace("<worldbody>", post))
    add_sand(spec)
    assert spec.compile().nbody == 2


def _assets() -> dict[str, bytes]:
    from mjgranular.models.link import model_path

    folder = model_path("link").parent / "assets"
    return {f"assets/{path.name}": path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_names_with_spaces_and_quotes(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(TWO_BEDS.replace('"left"', '"the left one\'s"'))
    add_sand(spec, law=DepthVelocityLaw(linear=1), surface=Bed("the left one's"), bodies=["a"])
    assert mujoco.MjModel.from_xml_string(spec.to_xml()).nplugin == 1


def test_a_medium_without_a_known_name_is_refused() -> None:
    mine = Medium("mine", "", Quantity(1500, "", ""), "link", {"link": {}})
    with pytest.raises(InputError, match="register_medium"):
        add_sand(Link().spec(), medium=mine)


def test_a_surface_of_ones_own_is_refused() -> None:
    class Sea(Surface):
        pass

    Sea.__abstractmethods__ = frozenset()
    with pytest.raises(InputError, match=r"Sea is not a surface .* plane"):
        add_sand(Link().spec(), surface=Sea())


def test_a_custom_surface_is_written_by_its_registered_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @dataclass(frozen=True)
    class Sea(Plane):
        pass

    monkeypatch.setattr(surfaces, "_things", dict(surfaces._things))
    surfaces.add("sea", Sea)
    depths = []
    for surface in (Sea(height=0.1), "sea height=0.1", Plane(height=0.1)):
        spec = Link().spec()
        add_sand(spec, surface=surface)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 50)
        depths.append(data.qpos[2])
    assert depths[0] == depths[1] == depths[2]


def test_a_name_that_is_taken_is_refused() -> None:
    spec = Link().spec()
    add_sand(spec, name="bed")
    with pytest.raises(InputError, match="'bed' already"):
        add_sand(spec, name="bed")


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("medium", "concrete", "play_sand"),
        ("medium", "nowhere.yaml", "nowhere.yaml"),
        ("medium", "50%s%n", "50%s%n"),
        ("law", "linkk", "link_distributed"),
        ("law", "link eta_x=3", "eta_d, eta_h, eta_v, exponent"),
        ("law", "link eta_d", "eta_d=..."),
        ("law", "link eta_d=much", "a number"),
        ("law", "link eta_d=-1", "not negative"),
        ("law", "link_distributed pieces=2.5", "integer"),
        ("law", " ", "there are"),
        ("surface", "sea", "bed, height_field, plane"),
        ("surface", "bed", "geom="),
        ("surface", "bed geom=nowhere", "bed, table"),
        ("surface", "plane height=inf", "finite"),
        ("scheme", "magic", "explicit"),
        ("scheme", "explicit half_step=yes", "true or false"),
        ("bodies", "arm", "link"),
        ("geoms", "arm", "link"),
        ("groups", "5", "0"),
        ("groups", "all", "integer"),
        ("geoms", "'link", "no closing quotation"),
        ("resolution", "fine", "integer"),
        ("resolution", "0", "at least 1"),
        ("draw", "colours", "forces, depth"),
    ],
)
def test_a_mistake_in_the_model_is_a_load_error(key: str, text: str, said: str) -> None:
    spec = Link().spec()
    spec.activate_plugin(NAME)
    spec.add_plugin(name="bed", plugin_name=NAME, active=True).config = {key: text}
    with pytest.raises(ValueError, match="engine error") as caught:
        spec.compile()
    for part in ("mjgranular 'bed'", said):
        assert part in str(caught.value)


def test_an_unknown_key_is_a_load_error() -> None:
    spec = Link().spec()
    spec.activate_plugin(NAME)
    spec.add_plugin(name="bed", plugin_name=NAME, active=True).config = {"median": "play_sand"}
    with pytest.raises(ValueError, match="median"):
        spec.compile()


def test_what_goes_wrong_later_is_an_error_too(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    from mjgranular.medium.file import EXAMPLE

    path = tmp_path / "mine.yaml"
    path.write_text(EXAMPLE)
    model = sandy_link(medium=path)
    path.unlink()
    for _ in range(3):
        with pytest.raises(mujoco.FatalError, match=r"config 'medium': cannot read"):
            mujoco.MjData(model)
    path.write_text(EXAMPLE)
    mujoco.mj_step(model, released(model))


def test_a_medium_that_is_replaced_is_seen(register: Any) -> None:
    def force(eta: float) -> float:
        constants = {"eta_d": 0.0, "eta_h": 0.0, "eta_v": eta, "exponent": 1.0}
        made = {name: Quantity(value, "", "") for name, value in constants.items()}
        medium = Medium("changing", "", Quantity(1500, "", ""), "link", {"link": made})
        register(medium, replace=True)
        model = sandy_link(medium="changing")
        data = released(model)
        data.qpos[1] -= 0.05
        mujoco.mj_forward(model, data)
        return data.qfrc_passive[1]

    assert force(20.0) == pytest.approx(2 * force(10.0))


def test_a_law_that_is_defined_again_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laws, "_things", dict(laws._things))

    def force(factor: float) -> float:
        class Changing(LinkLaw):
            name = "changing"

            def parameters(self, medium: Medium) -> np.ndarray:
                parameters = super().parameters(medium)
                parameters["eta_v"] *= factor
                return parameters

        register_law(Changing)
        model = sandy_link(law="changing eta_d=0 eta_h=0 eta_v=10 exponent=1")
        data = released(model)
        data.qpos[1] -= 0.05
        mujoco.mj_forward(model, data)
        return data.qfrc_passive[1]

    assert force(2.0) == pytest.approx(2 * force(1.0))


def test_a_model_that_is_changed_is_seen_by_new_data() -> None:
    model = sandy_link()
    forces = []
    for radius in (0.005, 0.01):
        model.geom("link").size[0] = radius
        data = released(model)
        mujoco.mj_forward(model, data)
        forces.append(np.linalg.norm(data.qfrc_passive))
    assert forces[1] > 1.5 * forces[0]


def test_the_scheme_is_chosen_anew_for_another_time_step() -> None:
    spec = Link().spec()
    add_sand(spec, law="link_distributed")
    model = spec.compile()
    for timestep, scheme in ((1e-5, "explicit"), (1e-3, "implicit"), (1e-5, "explicit")):
        ends = []
        model.opt.timestep = timestep
        for same in (model, sandy_link(law="link_distributed", scheme=scheme)):
            same.opt.timestep = timestep
            data = released(same)
            mujoco.mj_step(same, data, 5)
            ends.append(data.qvel.copy())
        np.testing.assert_array_equal(*ends)


def test_gravity_that_is_changed_is_seen_at_once(model: mujoco.MjModel) -> None:
    moon = copy.copy(model)
    data = released(moon)
    data.qvel[1] = -1e-9
    data.qpos[1] -= 0.05
    mujoco.mj_forward(moon, data)
    before = data.qfrc_passive[1]
    moon.opt.gravity[2] /= 6
    mujoco.mj_forward(moon, data)
    assert data.qfrc_passive[1] == pytest.approx(before / 6)


@pytest.mark.parametrize(
    "again",
    [copy.copy, copy.deepcopy, lambda data: pickle.loads(pickle.dumps(data))],
    ids=["copy", "deepcopy", "pickle"],
)
def test_a_copy_goes_on_as_the_original_does(
    model: mujoco.MjModel, landed: np.ndarray, again: Any
) -> None:
    data = released(model)
    mujoco.mj_step(model, data, 100)
    twin = again(data)
    mujoco.mj_step(model, data, 50)
    mujoco.mj_step(twin.model, twin, STEPS - 100)
    mujoco.mj_step(model, data, STEPS - 150)
    np.testing.assert_array_equal(twin.qpos, landed)
    np.testing.assert_array_equal(data.qpos, landed)


@pytest.mark.slow
def test_pickled_data_outlives_the_original(model: mujoco.MjModel, landed: np.ndarray) -> None:
    data = released(model)
    mujoco.mj_step(model, data, 100)
    content = pickle.dumps(data)
    del data
    gc.collect()
    twins = [pickle.loads(content) for _ in range(4)]
    del twins[1]
    gc.collect()
    for twin in twins:
        mujoco.mj_step(twin.model, twin, STEPS - 100)
        np.testing.assert_array_equal(twin.qpos, landed)


def test_states_are_carried_over(model: mujoco.MjModel, landed: np.ndarray) -> None:
    data, other, third = released(model), mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    parts = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, parts))
    mujoco.mj_getState(model, data, state, parts)
    mujoco.mj_setState(model, other, state, parts)
    mujoco.mj_copyData(third, model, data)
    for one in (other, third):
        mujoco.mj_step(model, one, STEPS - 100)
        np.testing.assert_array_equal(one.qpos, landed)


def test_rollout_with_threads(model: mujoco.MjModel, landed: np.ndarray) -> None:
    data = released(model)
    parts = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, parts))
    mujoco.mj_getState(model, data, state, parts)
    workers = [mujoco.MjData(model) for _ in range(2)]
    states, _ = rollout.rollout([model] * 5, workers, np.tile(state, (5, 1)), nstep=STEPS)
    np.testing.assert_array_equal(states[:, -1, 1:4], np.tile(landed, (5, 1)))


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_batch(model: mujoco.MjModel, landed: np.ndarray, threads: int, persistent: bool) -> None:
    batch = pytest.importorskip("mujoco.batch").Batch(model, 5, threads, persistent=persistent)
    batch.reset(keyframe=0)
    for _ in range(3):
        batch.step(nstep=STEPS // 3)
    np.testing.assert_array_equal(batch.qpos, np.tile(landed, (5, 1)))


def test_batch_with_the_implicit_scheme() -> None:
    batches = pytest.importorskip("mujoco.batch")
    spec = Link().spec()
    spec.option.timestep = 1e-3
    add_sand(spec, scheme="implicit", law="link_distributed")
    model = spec.compile()
    data = released(model)
    mujoco.mj_step(model, data, 50)
    twin = pickle.loads(pickle.dumps(data))
    mujoco.mj_step(model, data, 50)
    mujoco.mj_step(twin.model, twin, 50)
    np.testing.assert_array_equal(twin.qpos, data.qpos)
    for threads in (1, 2):
        batch = batches.Batch(model, 5, threads)
        batch.reset(keyframe=0)
        for _ in range(10):
            batch.step(nstep=10)
        np.testing.assert_array_equal(batch.qpos, np.tile(data.qpos, (5, 1)))


def test_two_implicit_sands_on_one_body() -> None:
    sands = [
        {"law": "link_distributed", "scheme": "implicit", "surface": Plane(0.0)},
        {"law": "link_distributed", "scheme": "implicit", "surface": Plane(0.02)},
    ]
    spec = Link().spec()
    spec.option.timestep = 1e-3
    bare = spec.compile()
    for arguments in sands:
        add_sand(spec, tunable=True, **arguments)  # both are meant
    model = spec.compile()
    mine, theirs = released(model), released(bare)
    doors = [Sand(bare, shared=True, **arguments) for arguments in sands]
    for _ in range(20):
        mujoco.mj_step(model, mine)
        mujoco.mj_step1(bare, theirs)
        for door in doors:
            door.apply(theirs)
        mujoco.mj_step2(bare, theirs)
        np.testing.assert_allclose(mine.qvel, theirs.qvel, rtol=1e-7)


@pytest.mark.parametrize(
    "names", [("right", "left"), ("left", "right", "off"), ("off", "right", "left")]
)
def test_what_stands_in_two_sands_rests_as_in_one(names: tuple[str, ...]) -> None:
    """Whatever their order, and beside a third that is switched off."""
    text = """<mujoco><option timestep="2e-3" integrator="implicitfast"><flag contact="disable"/>
      </option><worldbody>
      <geom name="left" type="box" size=".5 1 .5" pos="-.5 0 -.5"/>
      <geom name="right" type="box" size=".5 1 .5" pos=".5 0 -.5"/>
      <geom name="off" type="box" size="1 1 .5" pos="0 0 -.5"/>
      <body pos=".03 0 .05" euler="3 4 5"><freejoint/>
        <geom type="box" size=".1 .04 .03" mass="3"/>
      </body></worldbody></mujoco>"""
    alone = mujoco.MjSpec.from_string(text)
    add_sand(alone, surface=Bed("off"))
    spec = mujoco.MjSpec.from_string(text)
    for name in names:
        add_sand(spec, surface=Bed(name), name=name, tunable=True)
    one, two = alone.compile(), spec.compile()
    data, twin = mujoco.MjData(one), mujoco.MjData(two)
    if "off" in names:
        tune(two, twin.plugin_state, "off", active=0)
    mujoco.mj_step(one, data, 500)
    mujoco.mj_step(two, twin, 500)
    assert np.abs(data.qvel).max() < 1e-11
    assert twin.qpos == pytest.approx(data.qpos, abs=1e-5)  # facets that the seam cuts
    assert np.abs(twin.qvel).max() < 1e-11
    for name in names:
        tune(two, twin.plugin_state, name, active=0)
    two.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4  # which none can step
    mujoco.mj_step(two, twin)


def test_sands_with_a_sensor_between_them_are_solved_together() -> None:
    """The same block would name the sensor as the next sand."""
    start = '<plugin plugin="mjgranular.{}"><instance name="{{}}"><config key='
    end = "/></instance></plugin>"
    sand = start.format("sand") + '"surface" value="bed geom=b"' + end
    measure = '"measure" value="depth"/><config key="sand" value="a"'
    sensor = start.format("sensor") + measure + end
    ends = []
    for kinds, sensing in (((sensor, sand), "b"), ((sand, sensor), "c")):
        text = "".join(kind.format(name) for kind, name in zip(kinds, "bc", strict=True))
        model = mujoco.MjModel.from_xml_string(f"""<mujoco><option timestep="2e-3"/>
          <extension>{sand.format("a").replace("=b", "=a")}{text}</extension><worldbody>
          <geom name="a" type="box" size=".5 1 .5" pos="-.5 0 -.5"/>
          <geom name="b" type="box" size=".5 1 .5" pos=".5 0 -.5"/>
          <body><freejoint/><geom type="box" size=".1 .04 .03" mass="3"/></body></worldbody>
          <sensor><plugin plugin="mjgranular.sensor" instance="{sensing}"/></sensor></mujoco>""")
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 20)
        ends.append(data.qpos.copy())
    assert np.array_equal(*ends)


def test_batch_with_other_models(model: mujoco.MjModel) -> None:
    batches = pytest.importorskip("mujoco.batch")
    moon = copy.copy(model)
    moon.opt.gravity[2] = -1.6
    alone = released(moon)
    mujoco.mj_step(moon, alone, STEPS)
    expanded = batches.Batch(model, 2, 2)
    expanded.expand("opt.gravity")[1, 2] = -1.6
    given = batches.Batch(model, 2, 2)
    given.set_models([model, moon])
    for batch in (expanded, given):
        batch.reset(keyframe=0)
        batch.step(nstep=STEPS)
        np.testing.assert_array_equal(batch.qpos[1], alone.qpos)


def test_many_threads_make_and_step_models(landed: np.ndarray) -> None:
    ends, failures = [], []

    def work(law: str) -> None:
        try:
            for _ in range(3):
                model = sandy_link(law=law)
                data = released(model)
                mujoco.mj_step(model, data, STEPS)
                ends.append((law, data.qpos.copy()))
                broken = Link().spec()
                add_sand(broken).config = {"law": "link x=1"}
                with pytest.raises(ValueError, match="no option"):
                    broken.compile()
        except BaseException as error:
            failures.append(error)

    threads = [
        threading.Thread(target=work, args=(law,)) for law in ("link", "link_distributed") * 2
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=600)
    assert not failures
    assert len(ends) == 12
    for law, end in ends:
        assert np.array_equal(end, landed) == (law == "link")


def test_a_tree_that_sleeps_is_left_alone() -> None:
    spec = mujoco.MjSpec.from_string(ON_A_FLOOR)
    add_sand(spec, law=DepthVelocityLaw(constant=1.0), surface=Plane(0.02))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    body = model.body("ball")
    assert data.body_awake[body.id] == 0
    data.qfrc_passive[:] = 7.0
    data.cvel[body.id] = 1.0
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.qfrc_passive, 7.0)


def test_numbers_that_are_none_are_left_to_mujoco(model: mujoco.MjModel) -> None:
    data = released(model)
    data.qpos[1] -= 0.05
    data.qvel[1] = -1e9
    mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 1
    data.qpos[1] = 0.05
    data.qvel[1] = -1.0
    mujoco.mj_step(model, data)
    assert np.any(data.qfrc_passive)


CHILD = """
import pickle, sys
import mjgranular.engine
import mujoco
{mischief}
content = sys.stdin.buffer.read()
try:
    data = pickle.loads(content)
    mujoco.mj_step(data.model, data, {steps})
    print(data.qpos.tolist())
except Exception as error:
    print("error", error)
"""


def child(content: bytes, steps: int, mischief: str = "") -> subprocess.CompletedProcess[bytes]:
    """A process of its own that unpickles data and steps it."""
    code = CHILD.format(steps=steps, mischief=mischief)
    return subprocess.run([sys.executable, "-c", code], input=content, capture_output=True)


@pytest.mark.slow
def test_another_process_goes_on(model: mujoco.MjModel, landed: np.ndarray) -> None:
    data = released(model)
    mujoco.mj_step(model, data, 100)
    done = child(pickle.dumps(data), STEPS - 100)
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.array(eval(done.stdout)), landed)


@pytest.mark.slow
@pytest.mark.parametrize("woken", [False, True])
def test_another_process_that_lacks_something_says_so(register: Any, woken: bool) -> None:
    constants = dict.fromkeys(("eta_d", "eta_h", "eta_v", "exponent"), Quantity(1.0, "", ""))
    register(Medium("mine", "", Quantity(1500, "", ""), "link", {"link": constants}))
    content = pickle.dumps(released(sandy_link(medium="mine")))
    wake = (
        "from mjgranular.models import Link; spec = Link().spec(); "
        "mjgranular.engine.add_sand(spec); spec.compile()"
    )
    done = child(content, 1, wake if woken else "")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"error mjgranular 'sand': config 'medium': no medium 'mine'")


def test_importing_registers_and_compiles_nothing() -> None:
    code = """
import sys, mujoco, mjgranular
assert "mjgranular.engine.callbacks" not in sys.modules
xml = '<extension><plugin plugin="mjgranular.sand"><instance name="sand"/></plugin></extension>'
mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "mjgranular 'sand': no geom of the model can meet the sand" in done.stderr


def test_a_model_without_joints_is_refused_in_words() -> None:
    spec = mujoco.MjSpec.from_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
    add_sand(spec)
    with pytest.raises(ValueError, match="no geom of the model can meet the sand"):
        spec.compile()


@pytest.mark.slow
@pytest.mark.parametrize(
    "mischief",
    [
        'engine.fields_of("mjModel").pop("nq"); engine.record_of.cache_clear()',
        'engine.STRUCTS = {"mjOption": engine.STRUCTS["mjOption"]}',
    ],
    ids=["moved", "gone"],
)
def test_a_struct_that_cannot_be_read_is_told(mischief: str) -> None:
    code = """
import logging, mujoco
import mjgranular.engine
from mjgranular.kernel import engine
MISCHIEF
from mjgranular import Sand
from mjgranular.models import Link
spec = Link().spec()
bare = spec.compile()
mjgranular.engine.add_sand(spec)
for _ in range(2):
    try:
        spec.compile()
    except ValueError as error:
        print(error)
Sand(bare, scheme="explicit").step(mujoco.MjData(bare))
print("stepped")
"""
    code = code.replace("MISCHIEF", mischief)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("tested versions") == 2
    assert done.stdout.endswith("stepped\n")


def test_a_plugin_of_another_make_is_not_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    from mjgranular.engine import plugin
    from mjgranular.kernel.engine import LayoutError

    monkeypatch.setattr(plugin, "_refused", [])
    monkeypatch.setattr(plugin, "_PLUGINS", (plugin.Plugin("mjgranular.other", (), 1),))
    monkeypatch.setattr(plugin.ctypes, "sizeof", lambda struct: 1)
    plugin.register()
    with pytest.raises(LayoutError, match="tested versions"):
        add_sand(Link().spec())


@pytest.mark.parametrize("choice", ["bodies", "geoms", "groups"])
def test_a_choice_of_nothing_is_not_all(choice):
    spec = mujoco.MjSpec.from_string("<mujoco/>")
    with pytest.raises(InputError, match=f"{choice}: no names"):
        add_sand(spec, **{choice: []})


ROBOT = """
<mujoco><worldbody><body name="ball"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>
"""


class TestTwice:
    """One body, two sands in one place."""

    def test_added_twice(self):
        spec = mujoco.MjSpec.from_string(ROBOT)
        add_sand(spec, medium="quikrete_medium")
        add_sand(spec, medium="quikrete_medium", surface=Plane(height=-0.1))
        with pytest.raises(
            ValueError, match=r"'sand'.*: the sand 'sand_2' acts on body 'ball' too"
        ):
            spec.compile()

    def test_brought_along(self):
        """Each sand acts on all that moves in what it was attached to, the other robot included."""
        world = mujoco.MjSpec()
        for name in ("a", "b"):
            robot = mujoco.MjSpec.from_string(ROBOT)
            add_sand(robot, medium="quikrete_medium")
            world.attach(robot, prefix=name, frame=world.worldbody.add_frame())
        with pytest.raises(ValueError, match="would be resisted twice"):
            world.compile()

    def test_what_has_its_own_place_is_taken(self):
        two = ROBOT.replace("<body", '<geom name="a" type="box" size="1 1 1"/><body')
        two = two.replace("<body", '<geom name="b" type="box" size="1 1 1" pos="2 0 0"/><body')
        spec = mujoco.MjSpec.from_string(two)
        for name in ("a", "b"):
            law = {"medium": "quikrete_medium", "law": "rft3d", "scheme": "explicit"}
            add_sand(spec, surface=Bed(name), **law)
        assert len(sands_in(spec.compile())) == 2

    def test_sand_that_can_be_switched_off_is_taken(self):
        spec = mujoco.MjSpec.from_string(ROBOT)
        for medium in ("poppy_seed_loose", "poppy_seed_close"):
            add_sand(spec, medium=medium, tunable=True)
        assert len(sands_in(spec.compile())) == 2


UNPICKLED = """
import pickle, sys
for path in sys.argv[1:]:
    data = pickle.load(open(path, "rb"))
    import mujoco
    model = data if isinstance(data, mujoco.MjModel) else data.model
    data = mujoco.MjData(model) if data is model else data
    mujoco.mj_step(model, data)
    print(abs(data.qfrc_passive).max() > 0)
"""


def test_pickles_bring_the_plugin_along(tmp_path):
    spec = mujoco.MjSpec.from_string(ROBOT)
    add_sand(spec, medium="quikrete_medium")
    model = spec.compile()
    paths = [tmp_path / "model", tmp_path / "data"]
    for path, one in zip(paths, (model, mujoco.MjData(model)), strict=True):
        path.write_bytes(pickle.dumps(one))
    done = subprocess.run(
        [sys.executable, "-c", UNPICKLED, *paths], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "True"]


def test_names_in_files_stay(model: mujoco.MjModel) -> None:
    """Model files and pickles of earlier versions contain these."""
    assert NAME == "mjgranular.sand"
    assert SENSOR == "mjgranular.sensor"
    assert {"medium", "law", "surface", "scheme", "bodies", "geoms", "groups"} <= set(KEYS)
    assert {"resolution", "instead_of", "memory", "draw", "tunable"} <= set(KEYS)
    assert SENSOR_KEYS == ("measure", "sand")
    assert b"mjgranular.engine.pickles" in pickle.dumps(model)
    assert pickles.restore(dict, ((("a", 1),),)) == {"a": 1}


def test_pickles_of_other_models_stay_as_they_were():
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    assert b"mjgranular" not in pickle.dumps(model)
    assert copy.deepcopy(model).nv == pickle.loads(pickle.dumps(model)).nv == 0
