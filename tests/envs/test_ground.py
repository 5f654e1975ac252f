"""Sand in place of a floor, however the model writes where that is."""

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, SandSpec
from mjgranular.envs.ground import place

FLOOR = '<geom name="floor" type="plane" size="5 5 1" {}/>'
RAISED = f'<frame pos="1 0 0.1" euler="0 0 30">{FLOOR.format("")}</frame>'


def spec_of(floor):
    ball = '<body pos="0 0 1"><freejoint/><geom size="0.1"/></body>'
    return mujoco.MjSpec.from_string(f"<mujoco><worldbody>{floor}{ball}</worldbody></mujoco>")


@pytest.mark.parametrize(
    "floor",
    [
        *map(FLOOR.format, ("euler='20 0 0'", "zaxis='1 0 3'", "quat='0.9 0.1 0 0'")),
        f"<frame euler='20 0 0'>{FLOOR.format('')}</frame>",
    ],
)
def test_a_floor_that_is_not_level_needs_a_surface(floor):
    with pytest.raises(InputError, match="the floor 'floor' is not level"):
        place(spec_of(floor), [SandSpec()])
    spec = spec_of(floor)
    place(spec, [SandSpec(surface="plane height=0.2")])
    model = spec.compile()
    assert model.geom("floor").pos == pytest.approx([0, 0, 0.2])
    assert np.abs(model.geom("floor").quat) == pytest.approx([1, 0, 0, 0])


@pytest.mark.parametrize("floor", [RAISED, FLOOR.format("pos='1 0 0.1' euler='0 0 30'")])
def test_sand_is_at_the_height_of_a_level_floor(floor):
    (sand,) = place(spec_of(floor), [SandSpec()])
    assert sand.surface.height == pytest.approx(0.1)
