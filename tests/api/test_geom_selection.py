"""Which geoms meet the sand: by body, by geom, by group, or all of them."""

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, LinkLaw, Sand, UnknownNameError, media
from mjgranular.shape import select_geoms

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

# Of groups 0, 2, 3 and 5 there are geoms; of 0 and 3 there are some that collide and can move.
ROBOT = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" group="5"/>
    <body name="trunk">
      <freejoint/>
      <geom name="trunk" type="capsule" size=".1 .3"/>
      <geom name="paint" type="sphere" size=".1" group="2" contype="0" conaffinity="0"/>
      <body name="foot" pos="0 0 -1">
        <joint/>
        <geom name="foot" type="capsule" size=".1 .3" group="3"/>
        <geom name="toe" type="capsule" size=".02 .1" group="3" contype="0"/>
        <geom name="ghost" type="capsule" size=".02 .1" group="3" contype="0" conaffinity="0"/>
      </body>
    </body>
    <body name="post" pos="3 0 0"><geom name="post" type="capsule" size=".1 .3" group="5"/></body>
  </worldbody>
</mujoco>"""
EVERY = {"trunk", "foot", "toe"}


@pytest.fixture
def robot():
    return mujoco.MjModel.from_xml_string(ROBOT)


def named(model, **options):
    return {model.geom(geom).name for geom in select_geoms(model, **options)}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, EVERY),
        ({"groups": 3}, {"foot", "toe"}),
        ({"groups": [0]}, {"trunk"}),
        ({"groups": (0, 3)}, EVERY),
        ({"groups": np.array([3, 0, 3])}, EVERY),
        ({"groups": np.int64(3)}, {"foot", "toe"}),
        ({"groups": 2}, {"paint"}),  # none collides: whoever names it means what is drawn
        ({"groups": (2, 3)}, {"paint", "foot", "toe"}),
        ({"groups": 3, "bodies": "trunk"}, EVERY),
        ({"groups": 0, "geoms": "ghost"}, {"trunk", "ghost"}),
        ({"groups": 0, "geoms": "toe", "bodies": ["trunk"]}, {"trunk", "toe"}),
        ({"bodies": "all"}, EVERY),
        ({"geoms": "all"}, EVERY),
        ({"bodies": ["all"], "geoms": ["ghost"]}, {*EVERY, "ghost"}),
        ({"geoms": ["paint", "all"], "groups": 3}, {*EVERY, "paint"}),
    ],
)
def test_what_is_named_is_taken_together(robot, options, expected):
    assert named(robot, **options) == expected


def test_a_geom_of_an_explicit_pair_collides():
    pair = '<contact><pair geom1="floor" geom2="ghost"/></contact></mujoco>'
    model = mujoco.MjModel.from_xml_string(ROBOT.replace("</mujoco>", pair))
    assert named(model) == named(model, groups=(0, 3)) == {*EVERY, "ghost"}
    assert named(model, bodies="foot") == {"foot", "toe", "ghost"}


def test_leaving_out(robot):
    for options in ({}, {"groups": 3}, {"bodies": "all"}, {"geoms": "toe", "bodies": "trunk"}):
        left = named(robot, leave_out=[robot.geom("toe").id], **options)
        assert left == named(robot, **options) - {"toe"}


@pytest.mark.parametrize("group", [4, 5, -1, 6])
def test_a_group_without_anything_lists_those_with_something(robot, group):
    with pytest.raises(UnknownNameError) as caught:
        named(robot, groups=[3, group])
    assert caught.value.known == ("0", "2", "3")
    message = f"no geoms of bodies that can move in geom group {group}; there are: 0, 2, 3"
    assert str(caught.value) == message


@pytest.mark.parametrize("groups", ["0", "visual", ["a"], 1.0, [2.5], [[0]]])
def test_a_group_is_a_number(robot, groups):
    with pytest.raises(InputError, match="groups takes the number of a geom group, or several"):
        named(robot, groups=groups)


@pytest.mark.parametrize("option", ["bodies", "geoms", "groups"])
def test_none_of_them_is_nothing(robot, option):
    with pytest.raises(InputError, match="no geom of the model can meet the sand"):
        named(robot, **{option: []})


def test_a_thing_called_all_is_meant_by_its_name(robot):
    spec = mujoco.MjSpec.from_string(ROBOT)
    spec.body("foot").name = "all"
    spec.geom("ghost").name = "all"
    model = spec.compile()
    assert named(model, bodies="all") == {"foot", "toe"}
    assert named(model, geoms="all") == {"all"}


def test_sand_takes_groups(robot):
    sand = Sand(robot, groups=3, law="link")
    assert {robot.geom(int(geom)).name for geom in sand.elements["geom"]} == {"foot", "toe"}


@pytest.mark.parametrize("geom", ["trunk", "foot"])
@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("size", [0.0, np.nan])
def test_a_rod_of_no_size(robot, geom, index, size):
    spec = mujoco.MjSpec.from_string(ROBOT)
    spec.geom("foot").type = mujoco.mjtGeom.mjGEOM_CYLINDER
    model = spec.compile()
    model.geom(geom).size[index] = size
    law = LinkLaw.from_medium(media["play_sand"])
    if geom == "trunk" and (index, size) == (1, 0.0):  # a capsule of no length is a sphere
        assert Sand(model, law=law, geoms=geom).elements["half_length"] == pytest.approx(0.1)
    else:
        with pytest.raises(InputError, match=f"geom '{geom}' has a size of zero"):
            Sand(model, law=law, geoms=geom)
