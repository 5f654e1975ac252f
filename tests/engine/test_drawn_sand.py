"""The surface of sand that the plugin draws: where the sand acts, and nothing in the model."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, HeightField, Plane, Surface, add_sand
from mjgranular.engine import tune
from mjgranular.engine.looks import DrawnSand
from mjgranular.models import Link
from mjgranular.render.material import MATERIAL, radius_of

SAND = {"medium": "quikrete_medium"}
BLOCK = '<body pos="0 0 0.1"><freejoint/><geom name="g" type="box" size="0.1 0.06 0.04"/></body>'
WORLD = "<mujoco><worldbody>{ground}" + BLOCK + "</worldbody></mujoco>"
PLANES = [
    Plane(),
    Plane(height=0.3),
    Plane(slope=math.radians(30)),
    Plane(height=-0.2, slope=math.radians(-20), uphill=math.radians(130)),
]


def spec_of(ground: str = "") -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(WORLD.format(ground=ground))


def drawn(model: mujoco.MjModel, data: mujoco.MjData, room: int = 300) -> list[mujoco.MjvGeom]:
    """The rectangles that the plugin adds to a scene; the room is for all."""
    scene = mujoco.MjvScene(model, room)
    option, grasp, camera = mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera()
    mujoco.mjv_updateScene(model, data, option, grasp, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    assert scene.ngeom <= room
    planes, decor = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtCatBit.mjCAT_DECOR
    return [g for g in scene.geoms[: scene.ngeom] if g.type == planes and g.category == decor]


def check_plane(geoms: list[mujoco.MjvGeom], plane: Plane, raised: float = 0.0) -> None:
    """Holds all corners against the depth of the plane of that height, slope, direction."""
    assert geoms
    point = np.array([0.0, 0.0, plane.height]) + raised * plane.normal
    for geom in geoms:
        turn = np.array(geom.mat, float).reshape(3, 3)
        np.testing.assert_allclose(turn[:, 2], plane.normal, atol=1e-6)
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            corner = geom.pos + turn @ (geom.size * [x, y, 0])
            assert abs((corner - point) @ plane.normal) < 1e-5


@pytest.mark.parametrize("plane", PLANES)
def test_the_surface_is_drawn_where_the_sand_acts(plane: Plane) -> None:
    spec = spec_of()
    add_sand(spec, surface=plane, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:2] = 40.0, -30.0  # it follows the robot
    mujoco.mj_forward(model, data)
    geoms = drawn(model, data)
    check_plane(geoms, plane)
    # As films of runs with `Sand` have it.
    scene = mujoco.MjvScene(model, 300)
    DrawnSand(model, plane, radius=radius_of(model)).show(scene, data.xipos[1])
    assert len(geoms) == scene.ngeom
    for mine, other in zip(geoms, scene.geoms, strict=False):
        for name in ("size", "pos", "mat", "rgba", "matid", "texid", "texrepeat", "texuniform"):
            np.testing.assert_allclose(getattr(mine, name), getattr(other, name), atol=1e-6)


def test_nothing_of_the_model_changes_its_number() -> None:
    bare, spec = spec_of().compile(), spec_of()
    add_sand(spec, **SAND)
    model = spec.compile()
    for name in ("nq", "nv", "nu", "nbody", "ngeom", "nsensordata", "nlight", "npluginstate"):
        assert getattr(model, name) == getattr(bare, name), name
    assert model.stat.extent == bare.stat.extent
    assert (model.nmat, model.ntex) == (1, 1)


def test_it_stays_through_xml_and_attaching() -> None:
    spec = spec_of()
    add_sand(spec, **SAND)
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    world = mujoco.MjSpec()
    world.attach(spec, prefix="robot/", frame=world.worldbody.add_frame())
    for model in (again, world.compile()):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert {geom.matid for geom in drawn(model, data)} == {0}


def test_it_can_be_left_away() -> None:
    spec = spec_of('<geom name="floor" type="plane" size="1 1 1"/>')
    assert add_sand(spec_of(), draw="surface forces", **SAND).config["draw"] == "surface forces"
    add_sand(spec, draw=(), instead_of="floor", **SAND)
    assert spec.geom("floor").group == 0
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (model.nmat, drawn(model, data)) == (0, [])


def test_sand_written_by_hand_is_drawn_in_a_plain_colour() -> None:
    spec = spec_of()
    add_sand(spec, draw=(), **SAND).config = {"draw": "surface", **SAND}
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geoms = drawn(model, data)
    assert {geom.matid for geom in geoms} == {-1}
    red, green, blue, _ = geoms[0].rgba
    assert red > green > blue


def test_tunable_sand_is_drawn_at_its_height_and_only_where_it_is() -> None:
    spec, plane = spec_of(), Plane(slope=0.3)
    add_sand(spec, surface=plane, tunable=True, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    for raised in (0.0, 0.07, -0.2):
        tune(model, data.plugin_state, "sand", height=raised)
        mujoco.mj_forward(model, data)
        check_plane(drawn(model, data), plane, raised)
    tune(model, data.plugin_state, "sand", active=0)
    mujoco.mj_forward(model, data)
    assert not drawn(model, data)


def test_what_the_sand_replaces_is_not_shown() -> None:
    floors = '<geom name="floor" type="plane" size="1 1 1"/><geom type="box" size="1 1 0.01"/>'
    for names in (["floor", 1], ["floor", "1"]):
        spec = spec_of(floors)
        add_sand(spec, instead_of=names, **SAND)
        assert spec.compile().geom_group.tolist() == [5, 5, 0]


def test_ground_that_stays_lies_over_the_sand() -> None:
    spec = spec_of('<geom name="plate" type="box" pos="3 0 -0.1" size="1 1 0.1"/>')
    add_sand(spec, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    heights = {float(geom.pos[2]) for geom in drawn(model, data)}
    assert all(-1e-3 < height < 0 for height in heights)


def test_a_model_that_draws_its_own_sand_keeps_its_look() -> None:
    spec = Link().spec()  # a bed that is cut open, to show what is in it
    add_sand(spec, medium="play_sand")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not drawn(model, data)


@pytest.mark.parametrize(
    ("ground", "surface"),
    [
        ('<geom name="bed" type="box" pos="0 0 -0.1" size="1 1 0.1" {look}/>', Bed("bed")),
        ('<geom name="bed" type="hfield" hfield="h" {look}/>', HeightField("bed")),
    ],
)
def test_a_geom_that_is_sand_looks_so_unless_it_has_a_look(ground: str, surface: Surface) -> None:
    for look, material in (("", MATERIAL), ('rgba="1 0 0 1"', "")):
        spec = spec_of(ground.format(look=look))
        spec.add_hfield(name="h", nrow=3, ncol=3, size=[1, 1, 0.1, 0.1], userdata=[0.0] * 9)
        add_sand(spec, surface=surface, law="rft3d", scheme="explicit", **SAND)
        assert spec.geom("bed").material == material
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert not drawn(model, data)


def test_a_scene_without_room_is_filled_and_no_further() -> None:
    spec = spec_of()
    add_sand(spec, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert len(drawn(model, data, room=7)) == 7


def test_mujocos_renderer_shows_it_and_takes_it_for_background() -> None:
    spec = spec_of()
    spec.worldbody.add_light(pos=[0, 0, 2])
    add_sand(spec, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        renderer = mujoco.Renderer(model, 120, 160)
    except Exception as error:
        pytest.skip(f"no renderer: {error}")
    with renderer:
        renderer.update_scene(data)
        red, green, blue = (renderer.render()[..., i].astype(int) for i in range(3))
        assert ((red > green + 8) & (green > blue + 8)).mean() > 0.5
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data)
        assert set(np.unique(renderer.render()[..., 0])) == {-1, 0}
