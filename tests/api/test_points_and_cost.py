"""Feet that are points, and sands that cost much, are told of with what helps."""

from __future__ import annotations

import json
import shlex
import warnings

import mujoco
import pytest

from mjgranular import Sand, add_sand
from mjgranular.cli import main
from mjgranular.errors import CostWarning, PointsWarning
from mjgranular.sand.advice import MANY, find_points
from mjgranular.shape import select_geoms

# As a humanoid's foot is made: a sole that is only drawn, with four spheres under it.
FOOT = """
<body pos="{x} 0 1">{joint}
  <geom name="{shin}" type="capsule" size=".03 .1" pos="0 0 .2"/>
  <body name="{foot}"><joint axis="0 1 0"/>
    <geom type="box" size=".1 .04 .02" contype="0" conaffinity="0" group="2" mass="0"/>
    <geom size=".005" pos=".08 .03 -.02" mass=".1"/>
    <geom size=".005" pos=".08 -.03 -.02" mass=".1"/>
    <geom size=".005" pos="-.08 .03 -.02" mass=".1"/>
    <geom size=".005" pos="-.08 -.03 -.02" mass=".1"/>
  </body>
</body>"""
ROBOT = "<mujoco><worldbody>{}</worldbody></mujoco>".format(
    "".join(
        FOOT.format(x=x, joint="<freejoint/>", shin=f"{side} shin", foot=f"{side} foot")
        for x, side in ((0, "left"), (1, "right"))
    )
)
SOLES = [1, 7]
SAID = r"'left foot', 'right foot' meet the sand with points only, at most 10 mm wide.*they will "
ADVICE = r"sink.*take geoms=\['all', 1, 7\] \(--geoms all 1 7\)$"


@pytest.fixture
def robot():
    return mujoco.MjModel.from_xml_string(ROBOT)


def test_feet_that_are_points_are_found(robot):
    found = find_points(robot, select_geoms(robot))
    assert found == {1: [2, 3, 4, 5], 7: [8, 9, 10, 11]}
    assert list(found) == SOLES


def test_they_are_told_of(robot):
    with pytest.warns(PointsWarning, match=SAID + ADVICE):
        Sand(robot)


def test_they_are_told_of_within_the_engine():
    spec = mujoco.MjSpec.from_string(ROBOT)
    add_sand(spec)
    with pytest.warns(PointsWarning, match=SAID + ADVICE):
        spec.compile()


def test_of_bodies_that_are_named_the_soles_are_to_be_named_beside(robot):
    with pytest.warns(PointsWarning, match=r"'left foot' meets .* take geoms=\[1\] \(--geoms 1\)"):
        Sand(robot, bodies="left foot")


def test_the_advice_is_good(robot):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sand = Sand(robot, geoms=["all", *SOLES])
        Sand(robot, geoms=SOLES)
        Sand(robot, geoms=[2, 3, 4, 5])  # whoever names points means them
    sole = sand.elements[sand.elements["geom"] == 1]
    # All of it but what the spheres cover.
    skin = 8 * (0.1 * 0.04 + 0.04 * 0.02 + 0.02 * 0.1)
    assert sole["area"].sum() == pytest.approx(skin, rel=0.01)


@pytest.mark.parametrize("size", [0.02, 0.1])
def test_a_ball_for_a_foot_is_a_foot(size):
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size="{size}"/>
        <geom type="capsule" size=".02 .08" contype="0" conaffinity="0" mass="0"/></body>
        </worldbody></mujoco>"""
    )
    assert not find_points(model, [0])


def test_a_ball_under_a_long_cone_is_not_a_point():
    # A mesh's bounding radius is that from its centroid: of a cone 3/4 of its height.
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><mesh name="cone" vertex="-.1 -.1 0 .1 -.1 0 .1 .1 0 -.1 .1 0 0 0 .8"/>
        </asset><worldbody><body pos="0 0 1"><freejoint/><geom size=".075"/>
        <geom type="mesh" mesh="cone" contype="0" conaffinity="0" mass="0"/></body>
        </worldbody></mujoco>"""
    )
    assert not find_points(model, [0])


def test_geoms_by_number_in_python_mjcf_and_on_the_command_line(robot, tmp_path, capsys):
    expected = len(Sand(robot, geoms=[SOLES[0]]).elements)
    assert len(Sand(robot, geoms="1").elements) == expected
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    assert main(["elements", str(path), "--geoms", "1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["elements"], printed["geoms"][0]["geom"]) == (expected, "1")
    spec = mujoco.MjSpec.from_string(ROBOT)
    add_sand(spec, geoms=[1])
    text = spec.to_xml()
    assert '<config key="geoms" value="1"/>' in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mujoco.MjData(mujoco.MjModel.from_xml_string(text))


def test_a_group_of_what_is_drawn(robot, tmp_path, capsys):
    assert select_geoms(robot, groups=2) == SOLES
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    assert main(["elements", str(path), "--groups", "2"]) == 0
    out, err = capsys.readouterr()
    assert "left foot" in out
    assert not err


def test_the_command_tells_of_points(tmp_path, capsys):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    assert main(["elements", str(path)]) == 0
    _, err = capsys.readouterr()
    assert "with points only" in " ".join(err.split())
    assert shlex.split(err.rsplit("(--geoms", 1)[1].rstrip(")\n")) == ["all", "1", "7"]


@pytest.mark.slow
def test_sand_that_costs_much_says_what_would_help():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody>'
        "</mujoco>"
    )
    said = "elements take milliseconds in each step: take a lower resolution"
    with pytest.warns(CostWarning, match=said):
        sand = Sand(model, medium="quikrete_medium", resolution=150)
    assert len(sand.elements) > MANY
