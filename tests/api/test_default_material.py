"""Medium and law where one of them, or neither, is given: the same through every interface."""

import json
import logging
import pickle

import mujoco
import numpy as np
import pytest

from mjgranular import (
    InputError,
    LinkLaw,
    Rft3dLaw,
    Sand,
    SandSpec,
    UnknownNameError,
    add_sand,
    media,
)
from mjgranular.cli import main
from mjgranular.experiment import Drop, run_drop

LINK = '<geom name="g" type="capsule" size=".01 .1"/>'
ROBOT = (
    '<geom name="torso" type="sphere" size=".05"/><body><joint/>'
    '<geom type="capsule" fromto="0 0 0 .1 0 -.1" size=".01"/></body>'
)
BODIES = {
    "capsule": (LINK, "play_sand", "link"),
    "rod": ('<geom type="cylinder" size=".01 .1"/>', "play_sand", "link"),
    "disk": ('<geom type="cylinder" size=".1 .01"/>', "quikrete_medium", "rft3d_dynamic"),
    "block": ('<geom type="box" size=".1 .05 .03"/>', "quikrete_medium", "rft3d_dynamic"),
    "robot": (ROBOT, "quikrete_medium", "rft3d_dynamic"),
}

OF_RFT3D = "constants for it: poppy_seed_close, poppy_seed_loose, quikrete_medium"


def xml(geoms):
    return (
        '<mujoco><option timestep="2e-3"/><worldbody>'
        f'<body name="b" pos="0 0 .03"><freejoint/>{geoms}</body></worldbody></mujoco>'
    )


def model_of(geoms):
    return mujoco.MjModel.from_xml_string(xml(geoms))


def after(model, step, count=50):
    data = mujoco.MjData(model)
    for _ in range(count):
        step(data)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("name", BODIES)
def test_the_bodies_choose_the_medium_and_its_law(name):
    geoms, medium, law = BODIES[name]
    sand = Sand(model_of(geoms))
    assert (sand.medium.name, sand.law.name) == (medium, law)
    assert sand.spec.medium is None
    assert f"medium='{medium}', law='{law}'" in repr(sand)
    report = sand.report(mujoco.MjData(sand.model))
    assert (report.medium, report.law) == (medium, law)
    assert report.as_dict()["law"] == law
    assert repr(pickle.loads(pickle.dumps(sand))) == repr(sand)


@pytest.mark.parametrize("name", ["capsule", "robot"])
def test_every_interface_chooses_the_same(name, tmp_path, capsys):
    geoms, medium, law = BODIES[name]
    model = model_of(geoms)
    wanted = after(model, Sand(model, medium=medium, law=law).step)
    assert np.array_equal(after(model, Sand(model).step), wanted)

    spec = mujoco.MjSpec.from_string(xml(geoms))
    assert "medium" not in add_sand(spec).config
    within = spec.compile()
    found = after(within, lambda data: mujoco.mj_step(within, data))
    np.testing.assert_allclose(found, wanted, atol=1e-12)

    path = tmp_path / "robot.xml"
    path.write_text(xml(geoms))
    result = run_drop(Drop(path, duration=0.1))
    assert (result.medium, result.law) == (medium, law)
    assert np.array_equal(result.qpos[-1], wanted[: model.nq])
    for command in ("drop", "elements"):
        more = ["--duration", "0.01"] if command == "drop" else []
        assert main([command, str(path), "--json", *more]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["medium"], found["law"]) == (medium, law)


def test_the_other_follows_from_the_one_that_is_given():
    def chosen(**given):
        sand = Sand(model_of(LINK), **given)
        return sand.medium.name, sand.law.name

    assert chosen(law="rft3d") == ("quikrete_medium", "rft3d")
    assert chosen(law=Rft3dLaw) == ("quikrete_medium", "rft3d")
    assert chosen(law="rft2d") == ("play_sand", "rft2d")
    assert chosen(law="link_distributed") == ("play_sand", "link_distributed")
    assert chosen(law=LinkLaw(1.0, 2.0, 3.0, 1.1)) == ("play_sand", "link")
    assert chosen(law="depth_velocity") == ("glass_beads", "depth_velocity")
    assert chosen(medium="quikrete_medium") == ("quikrete_medium", "rft3d_dynamic")
    assert chosen(medium="glass_beads") == ("glass_beads", "rft2d_dynamic")


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
    with pytest.raises(UnknownNameError, match=rf"{OF_RFT3D}\)$") as found:
        Sand(model_of(ROBOT), medium="play_sand", law="rft3d")
    assert str(pickle.loads(pickle.dumps(found.value))) == str(found.value)
    spec = mujoco.MjSpec.from_string(xml(ROBOT))
    add_sand(spec, medium="play_sand")
    spec.plugins[0].config = {"medium": "play_sand", "law": "rft3d"}
    with pytest.raises(ValueError, match=rf"config 'law'.*{OF_RFT3D}"):
        spec.compile()


def test_the_log_says_what_was_chosen(caplog):
    with caplog.at_level(logging.INFO, "mjgranular.sand"):
        Sand(model_of(ROBOT))
    assert "medium quikrete_medium, law rft3d_dynamic" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO, "mjgranular.sand"):
        Sand(model_of(ROBOT), SandSpec(medium="quikrete_medium"))
    assert "quikrete_medium" not in caplog.text


def test_a_robot_of_gymnasiums_takes_a_law_alone():
    from mjgranular.envs import on_sand

    env = on_sand("Hopper-v5", law="link_distributed")
    assert env.unwrapped.sands[0].medium is None
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[1])
    env.close()
    assert media["play_sand"].default_law == "link"
