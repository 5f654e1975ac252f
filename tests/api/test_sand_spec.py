"""One description of a sand through every interface, and geoms that the sand replaces."""

import copy
import json
import pickle
from dataclasses import asdict, fields, replace

import mujoco
import numpy as np
import pytest

import mjgranular.envs
from mjgranular import Bed, InputError, Plane, Sand, SandSpec, UnknownNameError, add_sand
from mjgranular.cli import main
from mjgranular.engine.config import KEYS, read_config, write_config
from mjgranular.envs import on_sand
from mjgranular.envs.robots import ROBOT_SAND
from mjgranular.experiment import Drop, run_drop
from mjgranular.sand.spec import SandFields

FLOOR = '<geom name="floor" type="plane" size="3 3 .1"/>'
CURB = '<geom type="box" size="1 1 .05"/>'
ROBOT = """
<mujoco>
  <option timestep="2e-3"/>
  <worldbody>
    {ground}
    <body name="block" pos="0 0 0.1"><freejoint/>
      <geom name="foot" type="box" size=".1 .05 .03"/></body>
  </worldbody>
  {more}
</mujoco>
"""
QUIKRETE = SandSpec(medium="quikrete_medium")
REPLACED = replace(QUIKRETE, instead_of=["floor"])


def xml(ground=FLOOR, more=""):
    return ROBOT.format(ground=ground, more=more)


def compiled(ground=FLOOR, more=""):
    return mujoco.MjModel.from_xml_string(xml(ground, more))


def stepped(model, step, count=150):
    data = mujoco.MjData(model)
    for _ in range(count):
        step(data)
    return np.concatenate([data.qpos, data.qvel])


def within(model, count=150):
    return stepped(model, lambda data: mujoco.mj_step(model, data), count)


def with_plugin(text, sand):
    spec = mujoco.MjSpec.from_string(text)
    add_sand(spec, sand)
    return spec.compile()


@pytest.fixture(scope="module")
def sunk():
    """The end of the fall of a model that has no floor."""
    model = compiled(ground="")
    end = stepped(model, Sand(model, QUIKRETE).step)
    assert end[2] < 0.028  # the block's half height is 0.03
    return end


def test_the_keyword_arguments_are_the_fields():
    names = [field.name for field in fields(SandSpec)]
    assert list(SandFields.__annotations__) == names
    assert KEYS[: len(names)] == tuple(names)


def test_keyword_arguments_replace_fields_of_a_spec():
    model, plane = compiled(ground=""), Plane(-0.1)
    spec = SandSpec(medium="glass_beads", law="rft3d", surface=plane)
    sand = Sand(model, spec, medium="quikrete_medium", scheme="explicit")
    assert (sand.medium.name, sand.law.name, sand.surface) == ("quikrete_medium", "rft3d", plane)
    assert sand.spec == replace(spec, medium="quikrete_medium", scheme="explicit")
    assert spec.medium == "glass_beads"


def test_what_is_no_spec_is_refused():
    with pytest.raises(InputError, match=r"by a SandSpec, not by 'play_sand'.*medium='play_sand'"):
        Sand(compiled(), "play_sand")
    with pytest.raises(InputError, match="by a SandSpec"):
        add_sand(mujoco.MjSpec.from_string(xml()), {"medium": "play_sand"})
    with pytest.raises(TypeError, match="instead"):
        Sand(compiled(), instead="floor")


@pytest.mark.parametrize("given", [["floor"], "floor", [0], 0, ("0",)])
def test_a_body_sinks_into_the_sand_that_replaces_its_floor(given, sunk):
    model = compiled()
    sand = Sand(model, QUIKRETE, instead_of=given)  # and nothing warns of a floor
    assert (model.geom("floor").contype, model.geom("floor").conaffinity) == (0, 0)
    assert np.array_equal(stepped(model, sand.step), sunk)


def test_it_acts_alike_within_the_step(sunk):
    ends = []
    for ground, spec in ((FLOOR, REPLACED), ("", QUIKRETE)):
        ends.append(within(with_plugin(xml(ground), spec)))
    assert np.array_equal(*ends)
    np.testing.assert_allclose(ends[0], sunk, rtol=0, atol=1e-9)


def test_it_stays_through_xml_and_copies_of_the_spec(sunk):
    ground = '<geom name="my floor" type="plane" size="3 3 .1"/>' + CURB
    spec = mujoco.MjSpec.from_string(xml(ground))
    add_sand(spec, QUIKRETE, instead_of=["my floor", 1], name="mine")
    written = spec.to_xml()
    assert 'key="instead_of"' in written
    models = [mujoco.MjModel.from_xml_string(written), spec.copy().compile(), spec.compile()]
    ends = [within(model) for model in models]
    assert all(np.array_equal(end, ends[0]) for end in ends)
    np.testing.assert_allclose(ends[0], sunk, rtol=0, atol=1e-9)
    read = read_config(write_config(replace(QUIKRETE, instead_of=["my floor", 1])))
    assert read.sand.instead_of == ["my floor", "1"]


def test_copies_and_pickles_of_sand_know_it(sunk):
    model = compiled()
    sand = Sand(model, REPLACED)
    for again in (copy.copy(sand), copy.deepcopy(sand), pickle.loads(pickle.dumps(sand))):
        assert again.spec == REPLACED
        assert np.array_equal(stepped(again.model, again.step), sunk)
    assert pickle.loads(pickle.dumps(REPLACED)) == REPLACED


def test_a_run_of_a_model_knows_it(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(xml(FLOOR + CURB))
    drop = Drop(path, medium="quikrete_medium", instead_of=("floor", "1"), duration=0.3)
    bare = tmp_path / "bare.xml"
    bare.write_text(xml(""))
    found, wanted = run_drop(drop), run_drop(Drop(bare, medium="quikrete_medium", duration=0.3))
    assert np.array_equal(found.qpos, wanted.qpos)
    assert Drop.from_config(json.loads(json.dumps(asdict(drop), default=str))) == drop
    assert drop.sand == replace(QUIKRETE, surface=Plane(), instead_of=("floor", "1"))


def test_a_run_that_was_written_before_is_read(tmp_path):
    old = {
        "model": "robot.xml", "medium": "glass_beads", "law": None, "scheme": "implicit",
        "surface_height": 0.1, "slope": 0.2, "uphill": 0.0, "bed": None, "height_field": None,
        "bodies": ["block"], "geoms": [], "keyframe": None, "height": 0.1, "velocity": 0.0,
        "duration": 0.5, "timestep": None, "resolution": 4, "state": None, "site": None,
    }  # fmt: skip
    drop = Drop.from_config(old)
    assert drop.sand == SandSpec(
        medium="glass_beads", scheme="implicit", surface=Plane(0.1, 0.2), bodies=("block",),
        resolution=4, instead_of=(),
    )  # fmt: skip


def test_the_commands_know_it(tmp_path, capsys):
    path = tmp_path / "robot.xml"
    path.write_text(xml())
    depth = ["drop", str(path), "--duration", "0.3", "--json"]
    assert main([*depth, "--instead-of", "floor"]) == 0
    assert json.loads(capsys.readouterr().out)["bodies"][0]["greatest_depth"] > 2e-3
    assert main([*depth, "--instead-of", "foot"]) == 2
    assert "must be fixed to the world" in " ".join(capsys.readouterr().err.split())


@pytest.fixture
def hoppers(tmp_path):
    """Gymnasium's hopper with a curb at its feet, and without."""
    spec = mujoco.MjSpec.from_file(on_sand("Hopper-v5").unwrapped.fullpath)
    bare, curb = tmp_path / "bare.xml", tmp_path / "curb.xml"
    bare.write_text(spec.to_xml())
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="curb", type=box, size=[1, 1, 0.1], pos=[0, 0, -0.05])
    curb.write_text(spec.to_xml())
    return str(curb), str(bare)


def test_environments_know_it(hoppers):
    rewards = []
    for path, replaced in zip(hoppers, ["curb", None], strict=True):
        env = on_sand("Hopper-v5", xml_file=path, instead_of=replaced)
        env.reset(seed=0)
        rewards.append([env.step(np.full(3, 0.1))[1] for _ in range(20)])
        env.close()
    assert rewards[0] == rewards[1]


def test_environments_take_a_spec():
    env = on_sand("Hopper-v5", replace(ROBOT_SAND, medium="glass_beads", law="rft2d"))
    assert env.reset(seed=0)[1]["sand/valid"] in (True, False)
    task = mjgranular.envs.tasks["Hopper"](geoms=["foot_geom"], law="rft3d")
    assert isinstance(task, SandSpec)
    assert task.model.geom("floor").contype == 0


GHOST = xml(more='<contact><pair name="both" geom1="floor" geom2="foot"/></contact>')
MISTAKES = {
    "no such geom": (xml(), "flor", "no geom of the model 'flor'; there are: floor, foot"),
    "no such number": (xml(), 7, "no geom number 7"),
    "all": (xml(), "all", "no geom of the model 'all'"),
    "one that moves": (xml(), "foot", "ground that sand replaces must be fixed to the world"),
    "a pair": (GHOST, "floor", "contact pair 'both' .* 'floor' is ground that sand replaces"),
    "a pair alone": (
        GHOST.replace('name="foot"', 'name="foot" contype="0" conaffinity="0"'),
        "floor",
        r"remove that <pair>, and name 'foot' in geoms=\[...\]",
    ),
    "a pair of a bed": (GHOST.replace("plane", "box"), None, "'floor' is a bed"),
    "no name": (xml(), 1.5, "names or numbers, not by 1.5"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_told_and_change_nothing(case):
    text, name, said = MISTAKES[case]
    spec = replace(QUIKRETE, instead_of=name, surface=Bed("floor") if name is None else None)
    model = mujoco.MjModel.from_xml_string(text)
    with pytest.raises((InputError, UnknownNameError), match=said):
        Sand(model, spec)
    assert model.geom("floor").contype == 1
    with pytest.raises((InputError, ValueError, mujoco.FatalError), match=said):
        with_plugin(text, spec)


def test_within_mj_step_the_key_is_told():
    with pytest.raises(ValueError, match="no geom of the model 'flor'"):
        with_plugin(xml(), replace(QUIKRETE, instead_of="flor"))


def test_an_empty_choice_replaces_nothing():
    assert "instead_of" not in write_config(replace(QUIKRETE, instead_of=[]))
    model = compiled(ground="")
    assert Sand(model, QUIKRETE, instead_of=[]).spec.instead_of == []
