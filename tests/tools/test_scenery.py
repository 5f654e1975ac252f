"""What is drawn is where the sand acts."""

import math

import mujoco
import numpy as np
import pytest

from mjgranular import Plane
from mjgranular.experiment.scenery import add_bed


@pytest.mark.parametrize("angle", ["degree", "radian"])
@pytest.mark.parametrize(
    "surface",
    [
        Plane(),
        Plane(height=0.3),
        Plane(slope=math.radians(30)),
        Plane(height=-0.2, slope=math.radians(-20), uphill=math.radians(130)),
    ],
)
def test_the_bed_is_drawn_where_the_sand_acts(surface, angle):
    spec = mujoco.MjSpec.from_string(f'<mujoco><compiler angle="{angle}"/></mujoco>')
    add_bed(spec, surface)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    turn, half = data.geom_xmat[0].reshape(3, 3), model.geom_size[0]
    np.testing.assert_allclose(turn[:, 2], surface.normal, atol=1e-12)
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        corner = data.geom_xpos[0] + turn @ (half * [x, y, 1])
        depth = (np.array([0.0, 0.0, surface.height]) - corner) @ surface.normal
        assert abs(depth) < 1e-12


@pytest.mark.parametrize("lights", [0, 1])
def test_a_model_without_a_light_gets_one(lights):
    own = '<body><light pos="0 0 3"/></body>' * lights
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{own}</worldbody></mujoco>")
    add_bed(spec, Plane())
    assert spec.compile().nlight == 1
