"""Films by daylight: what is drawn is where the sand acts, lit, and no part of the model."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, HeightField, Plane
from mjgranular.engine.looks import DrawnSand, look_of_plane
from mjgranular.errors import RenderError
from mjgranular.experiment import Impact, run_impact
from mjgranular.experiment.drop import Drop, load, run_drop
from mjgranular.picture import video
from mjgranular.picture.scene import add_arrow
from mjgranular.picture.video import (
    Film,
    Motion,
    frames_of_drop,
    frames_of_impact,
    frames_of_model,
)
from mjgranular.render import skin
from mjgranular.render.material import MATERIAL, radius_of
from mjgranular.render.scenery import add_daylight, add_scenery

BLOCK = (
    '<body pos="0 0 0.1"><freejoint/><geom name="block" type="box" size="0.1 0.06 0.04"/></body>'
)
WAVES = " ".join(f"{0.5 + 0.5 * math.sin(i / 3):.3f}" for i in range(20) for _ in range(20))
SURFACES = {
    "plane": {},
    "slope": {"slope": math.radians(15), "uphill": 0.5},
    "bed": {"bed": "bed"},
    "field": {"height_field": "field"},
}
GROUND = {
    "bed": '<geom name="bed" type="box" size="0.6 0.6 0.1" pos="0 0 -0.1"/>',
    "field": '<geom name="field" type="hfield" hfield="waves" pos="0 0 -0.05"/>',
}
LIGHTS = {
    "none": "",
    "headlight off": '<visual><headlight active="0"/></visual>',
    "a lamp": '<worldbody><light pos="0 0 2" diffuse="1 1 1"/></worldbody>',
    "a bright laboratory": """
        <visual><headlight ambient=".8 .8 .8" diffuse="1 1 1"/></visual>
        <worldbody><light directional="true" diffuse="1 1 1" ambient=".5 .5 .5"/></worldbody>""",
    "night": """
        <asset><texture type="skybox" builtin="flat" rgb1="0 0 0" width="8" height="8"/></asset>""",
}


def write(folder: Path, surface: str = "plane", more: str = "", body: str = BLOCK) -> Path:
    path = folder / "model.xml"
    path.write_text(
        '<mujoco><asset><hfield name="waves" nrow="20" ncol="20" size="1 1 0.05 0.1" '
        f'elevation="{WAVES}"/></asset>{more}'
        f"<worldbody>{GROUND.get(surface, '')}{body}</worldbody></mujoco>"
    )
    return path


def film_of(drop: Drop, pictures: int = 3) -> list[np.ndarray]:
    result = run_drop(drop)
    model, _ = load(drop)
    film = Film(camera="free", width=160, height=120, fps=pictures * 2, seconds=0.5)
    motion = Motion(result.t, result.qpos, result.point, result.force)
    return list(frames_of_model(film, model, motion, drop.surface)[1])


def sandy(picture: np.ndarray) -> np.ndarray:
    """Where a picture has the colour of sand: red over green over blue."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return (red > green + 8) & (green > blue + 8)


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("light", LIGHTS)
def test_every_film_is_lit_and_shows_sand_under_a_sky(tmp_path, surface, light):
    drop = Drop(write(tmp_path, surface, LIGHTS[light]), duration=0.05, **SURFACES[surface])
    picture = film_of(drop)[-1]
    sand = picture[sandy(picture)]
    assert len(sand) > 0.25 * picture[..., 0].size
    assert 90 < sand.mean() < 200  # neither night nor burnt out
    assert (sand.max(axis=1) == 255).mean() < 0.02
    red, _, blue = (picture[..., i].astype(int) for i in range(3))
    assert ((blue > red + 10) & (blue > 120)).mean() > 0.01  # a sky by day


def test_relief_shows(tmp_path):
    deviations = []
    for height in ("0.2", "1e-4"):
        path = write(tmp_path, "field", body=BLOCK.replace("0 0 0.1", "0.7 0.7 0.2"))
        path.write_text(path.read_text().replace('size="1 1 0.05 0.1"', f'size="1 1 {height} 0.1"'))
        model, _ = load(Drop(path, height_field="field"))
        field = model.geom("field").id
        model.geom_matid[field], model.geom_rgba[field] = -1, 0.7  # light alone: the sun's
        model.vis.headlight.active = 0
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        camera = mujoco.MjvCamera()
        camera.distance, camera.elevation, camera.lookat[:] = 1.2, -80.0, [-0.3, -0.3, 0.1]
        with mujoco.Renderer(model, 120, 160) as renderer:
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            renderer.update_scene(data, camera)
            deviations.append(renderer.render()[:, 20:].mean(axis=2).std())  # no sky
    assert deviations[0] > 5
    assert deviations[1] < 2


@pytest.mark.parametrize(
    "surface",
    [
        Plane(),
        Plane(height=0.3),
        Plane(slope=math.radians(30)),
        Plane(height=-0.2, slope=math.radians(-20), uphill=math.radians(130)),
    ],
)
@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_the_plane_is_drawn_where_the_sand_acts(surface, angle):
    xml = f'<mujoco><compiler angle="{angle}"/><worldbody>{BLOCK}</worldbody></mujoco>'
    spec = mujoco.MjSpec.from_string(xml)
    add_scenery(spec, surface)
    model = spec.compile()
    middle = np.array([3.0, -7.0, 0.2])
    scene = mujoco.MjvScene(model, 500)
    DrawnSand(model, surface, radius=radius_of(model)).show(scene, middle)
    below = np.array([0.0, 0.0, surface.height])
    covered = []
    for geom in scene.geoms[: scene.ngeom]:
        turn = np.array(geom.mat, float).reshape(3, 3)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(turn[:, 2], surface.normal, atol=1e-6)
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            corner = geom.pos + turn @ (geom.size * [x, y, 0])
            assert abs((corner - below) @ surface.normal) < 1e-5
        away = turn.T @ (middle - geom.pos)
        covered.append(bool((abs(away[:2]) <= geom.size[:2] + 1e-6).all()))
    assert any(covered)  # it lies under what is looked at
    assert all(geom.matid == model.material(MATERIAL).id for geom in scene.geoms[: scene.ngeom])


def test_scenery_is_no_geom_and_keeps_the_numbers_of_geoms(tmp_path):
    path = write(tmp_path, body=BLOCK * 1 + BLOCK.replace('name="block"', ""))
    bare = mujoco.MjModel.from_xml_path(str(path))
    model, _ = load(Drop(path))
    assert (model.ngeom, model.nbody, model.nq) == (bare.ngeom, bare.nbody, bare.nq)
    assert model.stat.extent == bare.stat.extent
    by_number = run_drop(Drop(path, geoms=("1",), duration=0.2))
    assert [body.body for body in by_number.bodies] == ["2"]


def test_ground_of_the_models_own_is_never_in_one_plane_with_the_sand(tmp_path):

    def lowered(more, **options):
        model, _ = load(Drop(write(tmp_path, more=more), **options))
        look = look_of_plane(model, Plane(), radius_of(model))
        return None if look is None else look["lowered"]

    table = '<worldbody><geom name="table" type="box" size="0.2 0.2 0.1" pos="0 0 {}"/></worldbody>'
    assert lowered("") == 0
    assert lowered(table.format(-0.3), keep_floor=True) == 0
    under = lowered(table.format(-0.1), keep_floor=True)
    assert under is not None
    assert 0 < under < 1e-3  # hidden under the table
    assert lowered(table.format(-0.1), instead_of=("table",)) == 0
    drawing = '<worldbody><geom type="plane" size="1 1 1" contype="0" conaffinity="0"/></worldbody>'
    assert lowered(drawing) is None


def test_the_look_of_a_bed_that_somebody_has_coloured_stays():
    for colour, painted in (("", MATERIAL), ('rgba="1 0 0 1"', "")):
        xml = f"<mujoco><worldbody>{GROUND['bed']}{BLOCK}</worldbody></mujoco>"
        spec = mujoco.MjSpec.from_string(xml.replace('name="bed"', f'name="bed" {colour}'))
        add_scenery(spec, Bed("bed"))
        assert spec.geom("bed").material == painted
    add_scenery(spec, HeightField("nowhere"))  # told where the sand is made


def test_scenery_that_was_written_is_replaced():
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{BLOCK}</worldbody></mujoco>")
    add_scenery(spec, Plane())
    again = mujoco.MjSpec.from_string(spec.to_xml())
    add_scenery(again, Plane())
    model = again.compile()
    assert (model.nlight, model.ntex, model.nmat) == (1, 2, 1)


def test_a_small_model_beside_large_ground_is_in_view(tmp_path):
    wall = '<worldbody><geom type="box" size="5 0.1 1" pos="0 9 1"/></worldbody>'
    body = BLOCK.replace('size="0.1 0.06 0.04"', 'size="0.1 0.06 0.04" rgba="1 0 1 1"')
    picture = film_of(Drop(write(tmp_path, more=wall, body=body), duration=0.05))[-1].astype(int)
    red, green, blue = (picture[..., i] for i in range(3))
    assert ((red > 2 * green) & (blue > 2 * green)).mean() > 0.03


def test_what_stands_still_is_drawn_once(tmp_path, monkeypatch):
    drawn = []
    render = mujoco.Renderer.render
    monkeypatch.setattr(mujoco.Renderer, "render", lambda *a: drawn.append(1) or render(*a))
    pictures = film_of(Drop(write(tmp_path)), 40)
    assert len(pictures) == 80
    assert 5 < len(drawn) < 60


def test_a_sky_that_a_material_shows_stays_a_texture():
    spec = mujoco.MjSpec.from_string("""
        <mujoco>
          <asset>
            <texture name="sky" type="skybox" builtin="flat" rgb1="1 0 0" width="8" height="8"/>
            <texture type="skybox" builtin="flat" rgb1="1 0 0" width="8" height="8"/>
            <material name="mirror" texture="sky"/>
          </asset>
          <worldbody><geom size="1" material="mirror"/></worldbody>
        </mujoco>""")
    add_daylight(spec)
    model = spec.compile()
    assert model.tex("sky").type == mujoco.mjtTexture.mjTEXTURE_CUBE
    assert (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).sum() == 1


def test_an_arrow_is_a_decoration_whatever_was_in_memory():
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), maxgeom=1)
    scene.geoms[0].category = -1717986918
    add_arrow(scene, np.zeros(3), np.ones(3), 0.1)
    assert scene.ngeom == 1
    assert scene.geoms[0].category == mujoco.mjtCatBit.mjCAT_DECOR


def test_grains_around_the_start_are_no_mirror_images():
    texture = skin._texture(220, 0.01, 0.0)[: 220 * 220].reshape(220, 220, 2)
    assert not np.allclose(texture[1:40, 0], texture[-1:-40:-1, 0])
    np.testing.assert_allclose(np.abs(np.diff(texture, axis=0, append=texture[:1])).max(), 0.01)


def test_tendons_and_mocap_bodies_are_where_the_run_had_them(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text("""
        <mujoco><worldbody>
          <camera name="front" pos="0 -2 0.3" xyaxes="1 0 0 0 0 1"/>
          <body name="a" pos="-0.3 0 0.3"><freejoint/><geom size="0.05"/><site name="a"/></body>
          <body name="b" pos="0.3 0 0.3"><freejoint/><geom size="0.05"/><site name="b"/></body>
          <body name="goal" mocap="true" pos="0 5 -5">
            <geom size="0.1" rgba="0 1 0 1" contype="0" conaffinity="0"/></body>
        </worldbody><tendon><spatial width="0.03" rgba="1 0 1 1">
          <site site="a"/><site site="b"/></spatial></tendon>
        <keyframe><key name="up" mpos="0 0 0.7"/></keyframe></mujoco>""")
    drop = Drop(path, keyframe="up", duration=0.02)
    result = run_drop(drop)
    film = Film(camera="front", width=160, height=120, fps=4, seconds=0.5)
    picture = list(frames_of_drop(film, drop, vars(result), result.prints)[1])[-1]
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    assert ((red > 2 * green) & (blue > 2 * green)).sum() > 50  # the tendon
    assert ((green > 2 * red) & (green > 2 * blue)).sum() > 50  # the mocap body


def test_the_skin_of_a_film_has_the_size_of_the_memory_that_the_run_had(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(video, "_render", lambda *arguments: made.append(arguments))
    film = Film(camera="free", width=160, height=120)
    far = BLOCK.replace("0 0 0.1", "3 0 0.1").replace("block", "far")
    drop = Drop(write(tmp_path, body=BLOCK + far), memory="0.05", duration=0.002)
    fallen = run_drop(drop)
    frames_of_drop(film, drop, vars(fallen), fallen.prints)
    wide = {"body": "box", "length": 0.6, "diameter": 0.5, "medium": "quikrete_medium"}
    struck = run_impact(Impact(**wide, memory="0.05", duration=1e-3))
    frames_of_impact(film, struck.impact, struck.trajectory, None, struck.prints)
    for _, data, *_, (_, memory) in made:
        assert memory.size > 2 / memory.cell
        assert data.model.skin_vertnum == skin.vertex_count(skin.lines_of(memory))


def test_small_forces_are_written_with_decimals(tmp_path, monkeypatch):
    captions = []
    monkeypatch.setattr(video, "_captioned", lambda _, text, __: captions.append(text))
    pebble = '<body pos="0 0 0.003"><freejoint/><geom size="0.004" mass="1e-3"/></body>'
    film_of(Drop(write(tmp_path, body=pebble), duration=0.1))
    assert float(captions[-1].split(" = ")[2].split(" N")[0]) == pytest.approx(0.0098, rel=0.2)


@pytest.mark.parametrize("program", ["", "/nowhere/ffmpeg"])
def test_a_machine_without_ffmpeg_is_an_error_of_one_sentence(monkeypatch, program):
    find = pytest.importorskip("imageio_ffmpeg._utils")
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", program)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(find, "_get_ffmpeg_exe", lambda: None)
    mediapy = pytest.importorskip("mediapy")
    monkeypatch.setattr(mediapy._config, "ffmpeg_name_or_path", "ffmpeg")
    with pytest.raises(RenderError, match="no ffmpeg is found: install it, or let IMAGEIO_FFMPEG"):
        video.need_mediapy("A film")
