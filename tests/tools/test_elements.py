"""Elements to look at: what is drawn is what the law acts on, in figures, scenes and tables."""

import importlib
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mjgranular import MissingExtraError, OutputError, Sand, add_sand, errors
from mjgranular.cli import main
from mjgranular.experiment.drop import Drop
from mjgranular.models import model_path
from mjgranular.picture.elements import GAP, add_elements, draw_elements, facet_bodies
from mjgranular.picture.outlines import Shown, area_vectors, facet_corners, kind_of, polygons_of

FOOT = """
<mujoco><worldbody><body name="foot" pos="0.1 0 0"><freejoint/>
  <geom name="sole" type="box" size="0.08 0.05 0.015"/>
  <body name="shin"><joint axis="0 1 0" pos="0 0 0.02"/>
    <geom name="shin" type="capsule" size="0.02" fromto="0 0 0.035 0.05 0 0.17"/></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def foot():
    return mujoco.MjModel.from_xml_string(FOOT)


@pytest.fixture(scope="module")
def facets(foot):
    return Sand(foot, medium="quikrete_medium")


@pytest.fixture(scope="module")
def pyramid():
    spec = mujoco.MjSpec()
    corners = [0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]
    spec.add_mesh(name="p", uservert=corners, userface=[0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    body = spec.worldbody.add_body(name="p")
    body.add_freejoint()
    body.add_geom(name="p", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="p")
    body.add_geom(
        name="c", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.01, 0.03, 0], pos=[0.2, 0, 0]
    )
    return Sand(spec.compile(), medium="quikrete_medium")


@pytest.fixture(scope="module")
def rods():
    model = mujoco.MjModel.from_xml_path(str(model_path("double_pendulum")))
    return Sand(model, law="link_distributed")


@pytest.fixture(scope="module")
def blobs(foot):
    return Sand(foot, medium="glass_beads", law="depth_velocity")


def at_qpos0(sand):
    data = mujoco.MjData(sand.model)
    mujoco.mj_forward(sand.model, data)
    return data


def polygons(sand):
    return polygons_of(Shown.at(sand, at_qpos0(sand), "body"))


def test_facets_are_drawn_with_their_true_areas(facets):
    drawn, owners = polygons(facets)
    areas = np.linalg.norm(area_vectors(drawn), axis=1)
    assert (owners == np.arange(len(facets.elements))).all()
    np.testing.assert_allclose(areas, facets.elements["area"], rtol=1e-12)


def test_patches_of_meshes_are_drawn_with_their_areas(pyramid, tmp_path):
    facets = pyramid.elements
    assert set(facets["geom"]) == {0, 1}
    drawn, owners = polygons(pyramid)
    assert (owners == np.arange(len(facets))).all()
    vectors = area_vectors(drawn)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), facets["area"], rtol=1e-12)
    # Around their centroids, across their normals.
    mine = facets["geom"] == 0
    corners, patches = drawn[mine], facets[mine]
    np.testing.assert_allclose(corners.mean(axis=1), patches["point"], atol=1e-15)
    across = np.einsum("nki,ni->nk", corners - corners.mean(axis=1)[:, None], patches["normal"])
    np.testing.assert_allclose(across, 0, atol=1e-15)
    assert draw_elements(pyramid, file=tmp_path / "pyramid.png").axes
    scene = mujoco.MjvScene(pyramid.model, maxgeom=2 * len(facets))
    assert add_elements(scene, pyramid, at_qpos0(pyramid)) == 2 * len(facets)


def test_strips_of_patches_are_drawn_as_discs():
    # A patch that is hidden but for one row of its cells has no edge across that.
    kept = [("point", float, (3,)), ("normal", float, (3,)), ("area", float)]
    facets = np.zeros(2, [*kept, ("edges", float, (2, 3))])
    facets["normal"], facets["area"] = (0, 0, 1), (0.5, 0.1)
    facets["edges"] = [[(0.5, 0, 0), (0, 0.25, 0)], [(0.5, 0, 0), (0, 0, 0)]]
    corners = facet_corners(facets)
    np.testing.assert_allclose(area_vectors(corners)[:, 2], (0.5, 0.1))
    kinds, sizes, _ = facet_bodies(facets)
    assert kinds == [mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER]
    assert sizes[1, 0] == pytest.approx(math.sqrt(0.1 / math.pi))


def test_facets_with_edges_are_parallelograms_of_their_true_areas():
    kept = [("point", float, (3,)), ("normal", float, (3,)), ("area", float)]
    facet = np.zeros(1, [*kept, ("edges", float, (2, 3))])
    facet["point"], facet["normal"], facet["area"] = (1, 2, 3), (0, 0, 1), 0.5
    facet["edges"] = [(0.3, 0.1, 0), (0, 0.2, 0)]
    corners = facet_corners(facet)
    assert corners.shape == (1, 4, 3)
    np.testing.assert_allclose(area_vectors(corners), [[0, 0, 0.5]], atol=1e-15)
    np.testing.assert_allclose(corners.mean(axis=1), facet["point"])
    _, sizes, axes = facet_bodies(facet)
    volume = 8 * sizes.prod() * np.linalg.det(axes[0])
    assert volume == pytest.approx(2 * sizes[0, 2] * 0.5 * GAP**2)


def test_rods_are_drawn_from_end_to_end(rods):
    drawn, owners = polygons(rods)
    # The pendulum hangs straight down in qpos0, its pivot 0.36 m above the sand, 0.4 m long.
    assert drawn[..., 2].max() == pytest.approx(0.36)
    assert drawn[..., 2].min() == pytest.approx(-0.04)
    assert np.abs(drawn[..., 0]).max() == pytest.approx(0.005)
    assert set(owners) == set(range(40))


def test_blobs_are_drawn_as_far_as_they_reach(blobs):
    drawn, owners = polygons(blobs)
    sole, shin = drawn[owners == 0].reshape(-1, 3), drawn[owners == 1].reshape(-1, 3)
    np.testing.assert_allclose(sole.max(axis=0), [0.18, 0.05, 0.015])
    np.testing.assert_allclose(sole.min(axis=0), [0.02, -0.05, -0.015])
    # A capsule's outermost points lie on it: at its radius from its middle line.
    ends = np.array([[0.1, 0, 0.035], [0.15, 0, 0.17]])
    way = ends[1] - ends[0]
    share = np.clip((shin - ends[0]) @ way / (way @ way), 0, 1)
    distance = np.linalg.norm(shin - ends[0] - share[:, None] * way, axis=1)
    np.testing.assert_allclose(distance, 0.02, rtol=1e-9)


@pytest.mark.parametrize(
    ("geom", "reach"),
    [
        ("type='sphere' size='0.05'", (0.05, 0.05, 0.05)),
        ("type='ellipsoid' size='0.06 0.04 0.02'", (0.06, 0.04, 0.02)),
        ("type='cylinder' size='0.04 0.07'", (0.04, 0.04, 0.07)),
    ],
)
def test_blobs_of_every_shape(geom, reach):
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><freejoint/><geom {geom}/></body></worldbody></mujoco>"
    )
    sand = Sand(model, medium="glass_beads", law="depth_velocity")
    drawn, _ = polygons(sand)
    # None of the directions that are drawn lies along an axis.
    np.testing.assert_allclose(drawn.max(axis=(0, 1)), reach, rtol=0.04)
    assert (drawn.max(axis=(0, 1)) <= np.array(reach) * (1 + 1e-12)).all()
    scene = mujoco.MjvScene(model, maxgeom=1)
    assert add_elements(scene, sand, at_qpos0(sand)) == 1
    size = scene.geoms[0].size
    np.testing.assert_allclose(size, reach, rtol=1e-6)


def test_the_figure_says_what_it_shows(facets, rods, blobs):
    for sand, words in (
        (facets, f"{len(facets.elements)} facets of 2 geoms on 2 bodies, rft3d_dynamic law"),
        (rods, "40 rods of 2 geoms on 2 bodies, link_distributed law"),
        (blobs, "2 blobs of 2 geoms on 2 bodies, depth_velocity law"),
    ):
        figure = draw_elements(sand, title="mine")
        assert figure.get_suptitle() == f"mine\n{words}"
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["foot", "shin"]


def test_axes_of_the_figure_have_one_scale(facets):
    axes = draw_elements(facets).axes[0]
    ranges = [np.ptp(getattr(axes, f"get_{name}lim")()) for name in "xyz"]
    aspect = axes._box_aspect / axes._box_aspect.max()
    np.testing.assert_allclose(aspect, np.array(ranges) / max(ranges))
    assert axes.get_xlabel() == "x [m]"


def test_the_figure_follows_data(facets, tmp_path):
    raised, pushed = mujoco.MjData(facets.model), mujoco.MjData(facets.model)
    raised.qpos[2] += 1.0
    pushed.qvel[:] = -0.1
    for name, options in (
        ("raised.png", {"data": raised}),
        ("pushed.svg", {"forces": True, "data": pushed}),
        ("bare.pdf", {"color": "geom", "normals": False, "forces": True}),
    ):
        figure = draw_elements(facets, file=tmp_path / name, **options)
        assert (tmp_path / name).stat().st_size > 10_000
        low = figure.axes[0].get_zlim()[0]
        assert (low > 0.9) == (name == "raised.png")


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"color": "red"}, errors.UnknownNameError, "body, geom"),
        ({"file": "foot.bmp"}, errors.InputError, r"\.png, \.svg or \.pdf, not '\.bmp'"),
        ({"file": "nowhere/foot.png"}, OutputError, "cannot write"),
    ],
)
def test_mistakes_in_a_figure(facets, options, error, words):
    with pytest.raises(error, match=words):
        draw_elements(facets, **options)


def test_elements_of_another_kind_are_refused(facets):
    hairy = SimpleNamespace(law=facets.law, elements=np.zeros(1, [("geom", int), ("hair", float)]))
    with pytest.raises(errors.InputError, match="hair"):
        kind_of(hairy)


def scene_of(sand, data, room=2000):
    scene = mujoco.MjvScene(sand.model, maxgeom=room)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    options, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    mujoco.mjv_updateScene(sand.model, data, options, None, camera, everything, scene)
    return scene


def test_a_scene_gets_elements_normals_and_forces(facets):
    data = at_qpos0(facets)
    data.qvel[2] = -0.1
    scene, number = scene_of(facets, data), len(facets.elements)
    before = scene.ngeom
    assert add_elements(scene, facets, data, normals=False) == number
    assert scene.ngeom == before + number
    for k in (0, number // 2, number - 1):
        e = facets.elements[k]
        at = data.xpos[e["body"]] + data.xmat[e["body"]].reshape(3, 3) @ e["point"]
        np.testing.assert_allclose(scene.geoms[before + k].pos, at, atol=1e-7)
    assert {scene.geoms[k].rgba[3] for k in range(before)} == {0.25}
    assert add_elements(scene, facets, data) == 2 * number
    # Walls that slide along themselves are pushed by what rounding leaves, which nobody sees.
    force = np.linalg.norm(facets.report(data).elements.force, axis=1)
    pushed = (force > 0.01 * force.max()).sum()
    assert 0 < pushed <= (force > 0).sum()
    scene.ngeom = 0
    drawn = add_elements(scene, facets, data, forces=True)
    assert 2 * number + pushed <= drawn <= 2 * number + (force > 1e-6 * force.max()).sum()


def test_a_scene_gets_rods_and_blobs(rods, blobs):
    scene = scene_of(rods, at_qpos0(rods))
    before = scene.ngeom
    assert add_elements(scene, rods, at_qpos0(rods), color="geom") == 40
    np.testing.assert_allclose(scene.geoms[before].size, [0.005, 0.005, 0.005 * GAP], rtol=1e-6)
    scene = scene_of(blobs, at_qpos0(blobs))
    before = scene.ngeom
    assert add_elements(scene, blobs, at_qpos0(blobs)) == 2
    np.testing.assert_allclose(scene.geoms[before].size, [0.08, 0.05, 0.015], rtol=1e-6)


def test_a_scene_without_room_is_left_as_it_is(facets):
    data, needed = at_qpos0(facets), 2 * len(facets.elements)
    scene = scene_of(facets, data, room=needed)  # the model's own geoms are in it already
    before = scene.ngeom
    assert before > 0
    words = rf"\d+ more geoms and {needed} are needed"
    with pytest.raises(errors.InputError, match=words):
        add_elements(scene, facets, data)
    assert scene.ngeom == before
    assert scene.geoms[0].rgba[3] == 1.0


def test_data_of_another_model_is_refused(facets, rods):
    with pytest.raises(errors.InputError, match="another model"):
        add_elements(mujoco.MjvScene(rods.model, maxgeom=10), facets, at_qpos0(rods))


def test_elements_are_seen_in_a_picture(facets):
    data = at_qpos0(facets)
    with mujoco.Renderer(facets.model, 120, 160) as renderer:
        renderer.update_scene(data)
        bare = renderer.render()
        renderer.update_scene(data)
        add_elements(renderer.scene, facets, data)
        picture = renderer.render().astype(int)
    assert (picture != bare).any(axis=2).mean() > 0.02
    red, _, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert (blue > red + 40).any()  # the foot
    assert (red > blue + 40).any()  # the shin


@pytest.fixture
def foot_file(tmp_path):
    path = tmp_path / "foot.xml"
    path.write_text(FOOT)
    return path


def test_the_command_counts(foot_file, facets, capfd):
    assert main(["elements", str(foot_file), "--json"]) == 0
    printed = json.loads(capfd.readouterr().out)
    number = len(facets.elements)
    assert (printed["law"], printed["kind"], printed["elements"]) == (
        facets.law.name,
        "facets",
        number,
    )
    assert [row["geom"] for row in printed["geoms"]] == ["sole", "shin"]
    sole, shin = printed["geoms"]
    assert sole["area"] == pytest.approx(8 * (0.08 * 0.05 + 0.05 * 0.015 + 0.015 * 0.08))
    length = math.hypot(0.05, 0.135)
    skin = 2 * math.pi * 0.02 * length + 4 * math.pi * 0.02**2
    assert shin["area"] == pytest.approx(skin, rel=0.01)
    assert printed["area"] == pytest.approx(sole["area"] + shin["area"])
    assert printed["length"] is None
    assert (sole["shape"], sole["width"]) == ("box", pytest.approx(0.1))

    assert main(["elements", str(foot_file), "--geoms", "shin", "--resolution", "4"]) == 0
    shown = capfd.readouterr().out
    assert "shin" in shown
    assert "sole" not in shown


def test_groups_choose_alike_for_elements_and_drop(foot_file, tmp_path, capfd):
    foot_file.write_text(FOOT.replace('name="shin" type', 'name="shin" group="3" type'))
    counts = {}
    for groups in ("0", "3", "0 3"):
        material = ["--medium", "quikrete_medium"]  # without it a shin alone is a link
        chosen = [str(foot_file), "--groups", *groups.split(), "--json", *material]
        assert main(["elements", *chosen]) == 0
        printed = json.loads(capfd.readouterr().out)
        counts[groups] = printed["elements"]
        names = {"0": ["sole"], "3": ["shin"], "0 3": ["sole", "shin"]}[groups]
        assert [row["geom"] for row in printed["geoms"]] == names
        folder = tmp_path / f"fallen {groups}"
        assert main(["drop", *chosen, "--duration", "0.002", "--out", str(folder)]) == 0
        fallen = json.loads(capfd.readouterr().out)
        assert fallen["elements"] == counts[groups]
        bodies = {"sole": "foot", "shin": "shin"}
        assert [body["body"] for body in fallen["bodies"]] == [bodies[name] for name in names]
        config = json.loads((folder / "config.json").read_text())["config"]
        assert config["groups"] == [int(group) for group in groups.split()]
        assert Drop.from_config(config).groups == tuple(config["groups"])
    assert counts["0"] + counts["3"] == counts["0 3"]
    config.pop("groups")  # a run of before there was such a choice
    assert Drop.from_config(config).groups == ()


@pytest.mark.parametrize("command", ["drop", "elements"])
def test_wrong_groups(foot_file, capfd, command):
    assert main([command, str(foot_file), "--groups", "0", "2"]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert "geom group 2; there are: 0" in captured.err
    assert "Traceback" not in captured.err
    with pytest.raises(SystemExit) as stopped:  # what is no number never reaches the command
        main([command, str(foot_file), "--groups", "first"])
    assert stopped.value.code == 2
    assert "--groups" in capfd.readouterr().err


def test_the_command_writes_a_figure(tmp_path, capfd):
    pendulum = ["elements", str(model_path("double_pendulum")), "--law", "link"]
    figure = tmp_path / "deep" / "cut.svg"
    draw = [*pendulum, "--keyframe", "start", "--figure", str(figure)]
    assert main(draw) == 0
    assert "written to" in capfd.readouterr().out
    assert [path.name for path in figure.parent.iterdir()] == ["cut.svg"]
    assert main([*pendulum, "--figure", str(figure)]) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert main([*pendulum, "--json"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["length"] == pytest.approx(0.4)
    assert summary["area"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--figure", "foot.bmp"], ["a figure is written as", "'.bmp'"]),
        (["--keyframe", "stand"], ["keyframe", "stand"]),
        (["--geoms", "toe"], ["toe", "sole, shin"]),
        (["--groups", "2"], ["geom group 2", "there are: 0"]),
        (["--law", "link", "--medium", "play_sand"], ["sole", "capsules and cylinders"]),
        (["--resolution", "1"], ["at least 2"]),
        (["--resolution", "2000"], ["at most 200"]),
    ],
)
def test_mistakes_on_the_command_line(foot_file, tmp_path, monkeypatch, capfd, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main(["elements", str(foot_file), *arguments]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert all(word in captured.err for word in words)
    assert "Traceback" not in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["foot.xml"]


def test_a_model_that_is_not_there(tmp_path, capfd):
    assert main(["elements", str(tmp_path / "none.xml")]) == 2
    assert "MuJoCo cannot load" in capfd.readouterr().err


def test_without_matplotlib_the_numbers_are_still_printed(
    foot_file, facets, tmp_path, monkeypatch, capfd
):
    real = importlib.import_module

    def absent(name, *rest):
        if name.partition(".")[0] == "matplotlib":
            raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
        return real(name, *rest)

    monkeypatch.setattr("importlib.import_module", absent)
    with pytest.raises(MissingExtraError, match="figures"):
        draw_elements(facets)
    assert main(["elements", str(foot_file), "--figure", str(tmp_path / "cut.png")]) == 2
    captured = capfd.readouterr()
    assert "pip install 'mjgranular[figures]'" in captured.err
    assert str(len(facets.elements)) in captured.out


def test_a_model_with_sand_of_its_own_is_looked_at_too(tmp_path, capfd):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="rod"><freejoint/>'
        '<geom type="capsule" size=".01 .1"/></body></worldbody></mujoco>'
    )
    add_sand(spec, law="link")
    path = tmp_path / "rod.xml"
    path.write_text(spec.to_xml())
    assert main(["elements", str(path), "--medium", "play_sand", "--law", "link", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["elements"] == 1
    assert main(["drop", str(path), "--medium", "play_sand", "--law", "link"]) == 2
    assert "the model has sand" in capfd.readouterr().err


def test_the_picture_in_the_docs_can_be_drawn(monkeypatch):
    figures = Path(__file__).resolve().parents[2] / "docs" / "figures"
    monkeypatch.syspath_prepend(figures)
    for name in ("elements", "style"):  # other folders have scripts of these names
        monkeypatch.setitem(sys.modules, name, sys)  # which is taken back in the end
        del sys.modules[name]
    script, drawn = importlib.import_module("elements"), []
    assert Path(str(script.__file__)).parent == figures
    monkeypatch.setattr(script, "save", lambda figure, name: drawn.append(figure))
    monkeypatch.setattr(script, "rendered", lambda: np.zeros((56, 64, 3), np.uint8))
    script.main()
    assert len(drawn[0].axes) == 3
