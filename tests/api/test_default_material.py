"""Medium and law where one of them, or neither, is given: the same through every interface."""

import json
import pickle

import mujoco
import numpy as np
import pytest

from mjgranular import (
    GranularWarning,
    InputError,
    LinkLaw,
    Rft3dLaw,
    Sand,
    UnknownNameError,
    add_sand,
    media,
)
from mjgranular.cli import main
from mjgranular.experiment import Drop, run_drop
from mjgranular.models import Hexapod, Link, LiRobot, Projectile, model_path

LINK = '<geom name="g" type="capsule" size=".01 .1"/>'
ROBOT = (
    '<geom name="torso" type="sphere" size=".05"/><body><joint/>'
    '<geom type="capsule" fromto="0 0 0 .1 0 -.1" size=".01"/></body>'
)
BODIES = {
    "capsule": LINK,
    "rod": '<geom type="cylinder" size=".01 .1"/>',
    "block": '<geom type="box" size=".1 .05 .03"/>',
    "robot": ROBOT,
}
MARK = '<custom><text name="mjgranular.law" data="link"/></custom>'
DEFAULT, OF_LINKS = ("quikrete_medium", "rft3d_dynamic"), ("play_sand", "link")


def xml(geoms, head=""):
    return (
        f'<mujoco>{head}<option timestep="2e-3"/><worldbody>'
        f'<body name="b" pos="0 0 .03"><freejoint/>{geoms}</body></worldbody></mujoco>'
    )


def model_of(geoms, head=""):
    return mujoco.MjModel.from_xml_string(xml(geoms, head))


def after(model, step, count=50):
    data = mujoco.MjData(model)
    for _ in range(count):
        step(data)
    return np.concatenate([data.qpos, data.qvel])


def chosen(model, **fields):
    sand = Sand(model, **fields)
    return sand.medium.name, sand.law.name


@pytest.mark.parametrize("name", BODIES)
def test_bodies_of_any_shape_have_the_default_medium_and_its_law(name):
    medium, law = DEFAULT
    sand = Sand(model_of(BODIES[name]))
    assert (sand.medium.name, sand.law.name) == DEFAULT
    assert sand.spec.medium is None
    assert f"medium='{medium}', law='{law}'" in repr(sand)
    report = sand.report(mujoco.MjData(sand.model))
    assert (report.medium, report.law) == (medium, law)
    assert repr(pickle.loads(pickle.dumps(sand))) == repr(sand)


def test_the_packages_link_names_its_law():
    for model in (mujoco.MjModel.from_xml_path(str(model_path("link"))), Link().model(1e-4)):
        assert chosen(model) == chosen(model, medium="play_sand") == OF_LINKS
        assert chosen(model, medium="quikrete_medium") == DEFAULT
        assert chosen(model, law="rft3d") == ("quikrete_medium", "rft3d")
    assert chosen(Projectile(shape="capsule", diameter=0.02).model(1e-4)) == DEFAULT
    assert chosen(mujoco.MjModel.from_xml_path(str(model_path("double_pendulum")))) == DEFAULT


def test_a_link_that_becomes_a_part_of_a_robot_is_one_body_of_many():
    robot, link = mujoco.MjSpec.from_string(xml(ROBOT)), Link().spec()
    link.option.timestep, link.visual.map.znear = 2e-3, robot.visual.map.znear
    robot.worldbody.add_frame().attach_body(link.body("link"), "arm/", "")
    assert chosen(robot.compile()) == DEFAULT


def test_a_law_that_a_model_names_is_looked_up():
    with pytest.raises(UnknownNameError, match="no law 'lnik'"):
        Sand(model_of(LINK, MARK.replace("link", "lnik")))


def test_a_medium_that_brings_the_link_law_warns():
    model = model_of(LINK)
    with pytest.warns(GranularWarning, match=r"do not come to rest.*link_distributed"):
        assert chosen(model, medium="play_sand") == OF_LINKS
    with pytest.warns(GranularWarning, match=r"^medium 'play_sand' brings the law 'link'"):
        assert chosen(model, medium=media["play_sand"]) == OF_LINKS
    assert chosen(model, medium="play_sand", law="link") == OF_LINKS
    assert chosen(model_of(LINK, MARK), medium="play_sand") == OF_LINKS


CAPSULES = {  # orientation, radius, half length [m]
    "lying": ("1 0 1 0", 0.02, 0.15),
    "tilted": ("1 .4 0 0", 0.02, 0.15),
    "upright": ("1 0 0 0", 0.02, 0.15),
    "thin": ("1 .4 .2 0", 0.003, 0.1),
    "stubby": ("1 .3 .6 .1", 0.05, 0.01),
}


@pytest.mark.parametrize("robot", [Hexapod(), LiRobot()], ids=["Hexapod", "LiRobot"])
def test_robots_of_the_package_need_no_words_about_their_sand(robot):
    sand = Sand(robot.spec(2e-3).compile(), instead_of="floor")
    assert (sand.medium.name, sand.law.name) == DEFAULT


@pytest.mark.parametrize(
    ("name", "timestep", "integrator"),
    [
        ("lying", 1e-2, "Euler"),
        ("tilted", 2e-3, "implicitfast"),
        ("upright", 1e-2, "implicitfast"),
        ("thin", 5e-4, "Euler"),
        ("thin", 1e-2, "implicitfast"),
        ("stubby", 2e-3, "Euler"),
    ],
)
def test_a_free_capsule_comes_to_rest(name, timestep, integrator):
    turn, radius, half = CAPSULES[name]
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{timestep}" integrator="{integrator}"/><worldbody>'
        f'<body pos="0 0 {half + 3 * radius}" quat="{turn}"><freejoint/>'
        f'<geom type="capsule" size="{radius} {half}" density="1500"/></body></worldbody></mujoco>'
    )
    sand, data = Sand(model), mujoco.MjData(model)
    for _ in range(round(5 / timestep)):
        sand.step(data)
    then = data.qpos.copy()
    assert np.abs(data.qvel).max() < 1e-9
    for _ in range(round(1 / timestep)):
        sand.step(data)
    assert np.abs(data.qpos - then).max() < 1e-9


@pytest.mark.parametrize(("name", "head"), [("capsule", ""), ("robot", ""), ("capsule", MARK)])
def test_every_interface_chooses_the_same(name, head, tmp_path, capsys):
    medium, law = OF_LINKS if head else DEFAULT
    text = xml(BODIES[name], head)
    model = mujoco.MjModel.from_xml_string(text)
    wanted = after(model, Sand(model, medium=medium, law=law).step)
    assert np.array_equal(after(model, Sand(model).step), wanted)

    spec = mujoco.MjSpec.from_string(text)
    assert "medium" not in add_sand(spec).config
    within = spec.compile()
    found = after(within, lambda data: mujoco.mj_step(within, data))
    np.testing.assert_allclose(found, wanted, atol=1e-12)

    path = tmp_path / "robot.xml"
    path.write_text(text)
    result = run_drop(Drop(path, duration=0.1))
    assert (result.medium, result.law) == (medium, law)
    assert np.array_equal(result.qpos[-1], wanted[: model.nq])
    for command in ("drop", "elements"):
        more = ["--duration", "0.01"] if command == "drop" else []
        assert main([command, str(path), "--json", *more]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["medium"], found["law"]) == (medium, law)


def test_the_other_follows_from_the_one_that_is_given():
    model = model_of(LINK)
    assert chosen(model, law="rft3d") == ("quikrete_medium", "rft3d")
    assert chosen(model, law="rft3d") == ("quikrete_medium", "rft3d")
    assert chosen(model, law="rft2d") == ("play_sand", "rft2d")
    assert chosen(model, law="link_distributed") == ("play_sand", "link_distributed")
    assert chosen(model, law=LinkLaw(1.0, 2.0, 3.0, 1.1)) == ("play_sand", "link")
    assert chosen(model, law="depth_velocity") == ("glass_beads", "depth_velocity")
    assert chosen(model, medium="quikrete_medium") == ("quikrete_medium", "rft3d_dynamic")
    assert chosen(model, medium="glass_beads") == ("glass_beads", "rft2d_dynamic")


def test_options_of_a_law_in_mjcf_find_the_medium_too():
    spec = mujoco.MjSpec.from_string(xml(ROBOT))
    add_sand(spec)
    spec.plugins[0].config = {"law": "rft3d scale=1.5"}
    model = spec.compile()
    law = Rft3dLaw(**{**vars(Rft3dLaw.from_medium("quikrete_medium")), "scale": 1.5})
    bare = model_of(ROBOT)
    wanted = after(bare, Sand(bare, law=law).step)
    found = after(model, lambda data: mujoco.mj_step(model, data))
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_refusal_names_the_media_that_would_do():
    with pytest.raises(InputError, match=r"slender bodies.*quikrete_medium"):
        Sand(model_of(ROBOT), medium="play_sand")
    with pytest.raises(UnknownNameError, match="list laws NAME shows the media") as found:
        Sand(model_of(ROBOT), medium="play_sand", law="rft3d")
    assert str(pickle.loads(pickle.dumps(found.value))) == str(found.value)
    spec = mujoco.MjSpec.from_string(xml(ROBOT))
    add_sand(spec, medium="play_sand")
    spec.plugins[0].config = {"medium": "play_sand", "law": "rft3d"}
    with pytest.raises(ValueError, match=r"config 'law'.*list laws NAME shows the media"):
        spec.compile()


def test_a_robot_of_gymnasiums_takes_a_law_alone():
    from mjgranular.envs import on_sand

    env = on_sand("Hopper-v5", law="link_distributed")
    assert env.unwrapped.sands[0].medium is None
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])
    env.close()
    assert media["play_sand"].default_law == "link"
