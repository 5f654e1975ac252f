"""Sand in place of the floor of a user's model."""

import mujoco
import pytest

from mjgranular import InputError, SandSpec
from mjgranular.envs.ground import place

FLOOR = """<mujoco><worldbody>
  <frame pos="0 0 0.1"><geom name="floor" type="plane" size="1 1 1" {turn}/></frame>
  <body pos="0 0 1"><freejoint/><geom size="0.05"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("turn", ['euler="5 0 0"', 'zaxis="0 0.1 1"', 'quat="1 0.05 0 0"'])
def test_a_floor_that_is_not_level_is_refused(turn):
    spec = mujoco.MjSpec.from_string(FLOOR.format(turn=turn))
    with pytest.raises(InputError, match="'floor' is not level"):
        place(spec, [SandSpec()])


@pytest.mark.parametrize("turn", ["", 'euler="0 0 30"', 'quat="1 0 0 0.3"'])
def test_sand_is_where_the_floor_was(turn):
    spec = mujoco.MjSpec.from_string(FLOOR.format(turn=turn))
    (sand,) = place(spec, [SandSpec()])
    assert sand.surface.height == pytest.approx(0.1)


def test_a_floor_in_a_frame_is_drawn_where_the_sand_is():
    spec = mujoco.MjSpec.from_string(FLOOR.format(turn='euler="5 0 0"'))
    place(spec, [SandSpec(surface="plane height=0.2")])
    floor = spec.compile().geom("floor")
    assert (floor.pos.tolist(), floor.quat.tolist()) == ([0, 0, 0.2], [1, 0, 0, 0])


def test_the_floor_is_drawn_where_the_sand_is():
    tilted = FLOOR.format(turn='euler="0 -10 0"').replace("<frame", '<frame euler="0 10 0"')
    spec = mujoco.MjSpec.from_string(tilted)
    place(spec, [SandSpec()])
    floor = spec.compile().geom("floor")
    assert [*floor.pos, *floor.quat] == pytest.approx([0, 0, 0.1, 1, 0, 0, 0])


def test_names_that_are_taken_are_left_to_the_user():
    text = FLOOR.format(turn="").replace('name="floor"', "")
    others = '<body name="body_1"><geom name="mjgranular_floor_0" size="0.1"/></body></worldbody>'
    spec = mujoco.MjSpec.from_string(text.replace("</worldbody>", others))
    place(spec, [SandSpec()])
    model = spec.compile()
    assert [model.body(k).name for k in range(3)] == ["world", "body_1_", "body_1"]
    assert model.geom(0).name == "mjgranular_floor_0_"
