"""What a notebook shows: short lines, tables, films."""

import mujoco
import numpy as np
import pytest

import mjgranular
from mjgranular import InputError, Medium, Plane, Quantity, Sand, SandSpec, media
from mjgranular.experiment import Drop, Impact, run_drop, run_impact

XML = (
    '<mujoco><option timestep="2e-3"/><worldbody><body name="a<b>" pos="0 0 .03"><freejoint/>'
    '<geom type="box" size=".1 .05 .03"/></body></worldbody></mujoco>'
)


@pytest.fixture
def sand():
    return Sand(mujoco.MjModel.from_xml_string(XML), law="rft3d", scheme="explicit")


def test_short_lines(sand):
    assert repr(sand).endswith("elements on 1 body: 'a<b>')")
    assert repr(SandSpec()) == "SandSpec()"
    assert repr(SandSpec(medium="play_sand", groups=0)) == "SandSpec(medium='play_sand', groups=0)"
    assert repr(SandSpec(bodies=np.array([1, 2]))) == "SandSpec(bodies=array([1, 2]))"
    assert repr(SandSpec(surface=Plane())).startswith("SandSpec(surface=Plane(")
    assert repr(media["play_sand"]) == (
        "Medium('play_sand': Play sand (Quikrete 1113-51), 2500 kg/m^3, laws link, rft2d)"
    )
    data = mujoco.MjData(sand.model)
    data.qpos[2] = 0.02
    report = sand.report(data)
    assert repr(report).startswith("Report(t=0 s, quikrete_medium, rft3d law: a<b> 10 mm deep, ")
    assert len(repr(report)) < 100


def test_media_are_plain():
    odd = Medium("<i>", "\x1b[2J", Quantity(1500.0, "kg/m^3", "<script>"), "x", {"x": {}})
    assert "\x1b" not in repr(odd)


@pytest.fixture
def films(monkeypatch):
    mediapy = pytest.importorskip("mediapy")
    found = []
    monkeypatch.setattr(
        mediapy,
        "show_video",
        lambda film, fps: found.append((len(film), fps, film[0].shape[2])),
    )
    return found


def test_pictures_are_played(films):
    mjgranular.show(np.zeros((7, 16, 16, 3), np.uint8), fps=12)
    mjgranular.show(np.zeros((16, 16, 4), np.uint8) for _ in range(3))
    assert films == [(7, 12, 3), (3, 30, 3)]


@pytest.mark.parametrize("film", [[], 7, [1, 2], [np.zeros((2, 2, 3)), np.zeros((3, 2, 3))]])
def test_what_is_no_film(films, film):
    with pytest.raises(InputError, match="show takes pictures of one size"):
        mjgranular.show(film)


def test_results_are_filmed(films, tmp_path):
    path = tmp_path / "block.xml"
    path.write_text(XML)
    mjgranular.show(run_drop(Drop(path, duration=0.02)), seconds=0.2, fps=10)
    impact = run_impact(Impact(speed=2.0, timestep=1e-4, duration=0.02))
    mjgranular.show(impact, seconds=0.2, fps=10)
    assert films[0] == (2, 10, 3)
    assert films[1][0] >= 2
