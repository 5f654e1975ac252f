"""Figures and films: they are made, they show what they should, and refusals are clear."""

import json

import numpy as np
import pytest

from mjgranular import errors
from mjgranular.cli import main
from mjgranular.experiment import Impact, run_impact
from mjgranular.models import Link
from mjgranular.picture.video import Film, check_camera, frames_of_impact, write_video


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("impact") / "run"
    assert main(["impact", "--out", str(folder)]) == 0
    return folder


def film_frames(impact, **options):
    result = run_impact(impact)
    film = Film(width=320, height=240, fps=5, seconds=1.0, hold=0.4, **options)
    stop = result.stop.time if result.stop else None
    count, frames = frames_of_impact(film, impact, result.trajectory, stop)
    pictures = list(frames)
    assert len(pictures) == count
    return pictures


def sandy(picture):
    """Where a picture has the colour of sand: red over green over blue."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return (red > green + 10) & (green > blue + 10)


def arrow(picture):
    """Where a picture has the red of the force arrow."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return (red > 2.2 * green) & (red > 2.2 * blue) & (red > 80)


@pytest.mark.parametrize("camera", ["side", "close", "corner"])
def test_the_film_shows_sand_and_force(camera):
    pictures = film_frames(Impact(), camera=camera)
    assert pictures[0].shape == (240, 320, 3)
    assert sandy(pictures[0]).mean() > 0.15
    assert arrow(pictures[0]).sum() == 0  # no force at touch-down
    assert arrow(pictures[2]).sum() > 10
    assert (pictures[0] != pictures[2]).any()
    assert (pictures[-1] == pictures[-2]).all()  # the last picture stands


def test_scenery_follows_the_size_of_the_link():
    small = film_frames(Impact(length=0.02, diameter=0.001, speed=1.0))[0]
    large = film_frames(Impact(length=2.0, diameter=0.1, speed=1.0))[0]
    assert np.abs(sandy(small).mean() - sandy(large).mean()) < 0.02


def test_the_surface_is_drawn_where_the_physics_has_it():
    spec = Link().spec()
    bed = spec.geom("bed")
    assert bed.pos[2] + bed.size[2] == pytest.approx(0, abs=1e-12)
    model = spec.compile()
    assert model.geom("bed").contype[0] == 0
    assert model.geom("bed").conaffinity[0] == 0


def test_render_makes_a_film_of_a_saved_run(saved, tmp_path, capfd):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "films" / "close.MP4"
    arguments = ["render", str(saved), "--camera", "close", "--out", str(path)]
    small = ["--seconds", "1", "--width", "320", "--height", "240"]
    assert main([*arguments, *small]) == 0
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert seconds == pytest.approx(2.0, abs=0.05)  # a second of impact, one of the last picture
    assert frames == pytest.approx(60, abs=1)
    capfd.readouterr()
    assert main([*arguments, *small]) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert [file.name for file in path.parent.iterdir()] == ["close.MP4"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--camera", "back"], ["back", "side, close, corner"]),
        (["--width", "321"], ["even"]),
        (["--fps", "0"], ["frames a second"]),
        (["--seconds", "nan"], ["seconds"]),
        (["--out", "film.avi"], [".mp4"]),
    ],
)
def test_mistakes_in_a_film(saved, capfd, arguments, words):
    before = sorted(path.name for path in saved.iterdir())
    assert main(["render", str(saved), *arguments]) == 2
    error = capfd.readouterr().err
    assert all(word in error for word in words)
    assert sorted(path.name for path in saved.iterdir()) == before


def test_a_folder_without_a_run_is_refused(tmp_path, saved, capfd):
    assert main(["render", str(tmp_path / "nowhere")]) == 2
    assert "mjgranular impact --out" in capfd.readouterr().err
    broken = tmp_path / "broken"
    broken.mkdir()
    for name in ("config.json", "summary.json"):
        (broken / name).write_bytes((saved / name).read_bytes())
    (broken / "trajectory.npz").write_bytes(b"not an archive")
    assert main(["render", str(broken)]) == 2
    assert "Traceback" not in capfd.readouterr().err


def test_without_gl_the_numbers_are_still_written(tmp_path, capfd, monkeypatch):
    def no_gl(*arguments, **options):
        raise RuntimeError("no display")

    monkeypatch.setattr("mujoco.Renderer", no_gl)
    folder = tmp_path / "run"
    assert main(["impact", "--out", str(folder), "--video"]) == 2
    assert "libegl1" in capfd.readouterr().err
    assert json.loads((folder / "summary.json").read_text())["stopped"]
    assert not (folder / "impact.mp4").exists()


@pytest.mark.parametrize(
    ("package", "arguments", "line"),
    [
        ("matplotlib", [], "pip install 'mjgranular[figures]'"),
        ("mediapy", ["--video"], "pip install 'mjgranular[video]'"),
    ],
)
def test_a_missing_extra_names_the_install_line(
    tmp_path, capfd, monkeypatch, package, arguments, line
):
    import importlib

    real = importlib.import_module

    def absent(name, *rest):
        if name.partition(".")[0] == package:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
        return real(name, *rest)

    monkeypatch.setattr("importlib.import_module", absent)
    folder = tmp_path / "run"
    assert main(["impact", "--out", str(folder), *arguments]) == 2
    assert line in capfd.readouterr().err
    assert (folder / "summary.json").exists()


def test_film_options_are_checked():
    with pytest.raises(errors.InputError, match="even"):
        Film(width=101)
    with pytest.raises(errors.UnknownNameError, match="side, close, corner"):
        check_camera(Link().spec().compile(), "nose")


def test_the_figure_of_many_bodies_shows_those_with_the_largest_forces(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    from mjgranular.picture import figures

    drawn, save = [], Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda f, path: (drawn.append(f), save(f, path)))
    t, count = np.linspace(0, 1, 5), 20
    size = np.array([(7 * k) % count for k in range(count)], float)
    force = np.zeros((5, count, 3))
    force[2, :, 2] = size
    names = [f"body {k}" for k in range(count)]
    depth = np.full((5, count), 0.01)
    figures.draw_drop(tmp_path / "drop.png", t, names, depth, force, depth, title="robot.xml")
    legend = [text.get_text() for text in drawn[0].axes[0].get_legend().get_texts()]
    assert legend == [f"body {k}" for k in range(count) if size[k] >= count - 8]
    assert "8 bodies with the largest forces, of 20" in drawn[0].get_suptitle()


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    mediapy = pytest.importorskip("mediapy")

    close = mediapy.VideoWriter.close

    def full(writer):
        close(writer)
        raise RuntimeError("Error writing 'x.mp4': [mp4 @ 0x1] Error closing: No space left\n")

    monkeypatch.setattr(mediapy.VideoWriter, "close", full)
    film, black = Film(width=32, height=32), np.zeros((32, 32, 3), np.uint8)
    with pytest.raises(errors.OutputError, match=r"written: Error closing: No space left$"):
        write_video(tmp_path / "film.mp4", film, 2, iter([black, black]))
    assert not list(tmp_path.glob("film.mp4"))
