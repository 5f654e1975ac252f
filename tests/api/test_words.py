"""Laws, surfaces and schemes in words: one parser for Python, MJCF and the command line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import pytest

import mjgranular as mg
from mjgranular import InputError, UnknownNameError
from mjgranular.cli import main
from mjgranular.engine.config import read_config
from mjgranular.errors import GranularWarning
from mjgranular.law import check_constants, get_law
from mjgranular.medium import read_medium

BLOCK = """
<mujoco model="block">
  <worldbody>
    <body name="block" pos="0 0 0.01">
      <freejoint/>
      <geom name="block" type="box" size="0.05 0.03 0.02" density="2000"/>
    </body>
  </worldbody>
</mujoco>
"""
SCALED = "rft3d scale=1.3"
MUD = """
from dataclasses import dataclass, field
from mjgranular import DepthVelocityLaw, register_law

@dataclass(frozen=True)
class Mud(DepthVelocityLaw):
    name = "mud_of_a_test"
    title = "mud"
    citation = "nobody"
    stiffness: float = 500.0
    linear: float = 5.0

@register_law
@dataclass(frozen=True, kw_only=True)
class Clay(Mud):
    name = "clay_of_a_test"
    thickness: float
"""
MEDIUM = """\
name: mine
title: Mine
density: {value: 1500, unit: kg/m^3, source: weighed}
default_law: rft3d
constants:
  rft3d:
    density: {value: 3000, source: guessed}
    internal_friction: {value: 0.4, source: guessed}
    surface_friction: {value: 0.4, source: guessed}
"""


def block() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(BLOCK)


def test_parameters_stand_behind_the_name_of_a_law() -> None:
    own = mg.Rft3dLaw.from_medium("quikrete_medium")
    sand = mg.Sand(block(), law=SCALED)
    assert sand.law == get_law("rft3d scale=1.3", sand.medium)
    assert sand.law.scale == 1.3
    assert sand.law.density == own.density
    assert sand.medium.name == "quikrete_medium"


def test_all_ways_in_give_the_same_law(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The force of the sand on a block that goes down, by four ways."""
    sand = mg.Sand(block(), law=SCALED, scheme="explicit")
    assert read_config({"law": SCALED, "medium": "quikrete_medium"}).sand.law == sand.law
    spec = mujoco.MjSpec.from_string(BLOCK)
    mg.add_sand(spec, law=SCALED)
    assert '<config key="law" value="rft3d scale=1.3"/>' in spec.to_xml()
    monkeypatch.chdir(tmp_path)
    Path("block.xml").write_text(BLOCK, encoding="utf-8")
    forces = {}
    for law in ("rft3d", SCALED):
        given = ["--model", "block.xml", "--law", law, "--points", "2", "--json"]
        assert main(["intrude", *given]) == 0
        forces[law] = json.loads(capsys.readouterr().out)[-1]["resistance"]
    assert forces[SCALED] == pytest.approx(1.3 * forces["rft3d"])


def test_surfaces_and_schemes_in_words() -> None:
    sand = mg.Sand(
        block(),
        law="rft3d",
        surface="plane height=0.1 slope=0.2",
        scheme="explicit half_step=false",
    )
    assert sand.surface == mg.Plane(height=0.1, slope=0.2)
    assert sand.scheme == mg.Explicit(half_step=False)
    with pytest.raises(InputError, match="the surface 'bed' needs geom="):
        mg.Sand(block(), surface="bed")


def test_a_robot_starts_on_a_surface_in_words() -> None:
    pytest.importorskip("gymnasium")
    from mjgranular.envs import SandEnv

    heights = []
    for surface in ("plane height=0.3", mg.Plane(height=0.3)):
        env = SandEnv("Hopper", surface=surface)
        env.reset(seed=0)
        heights.append(env.data.body("torso").xpos[2])
    assert heights[0] == heights[1] > 1.4


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("rft3d scael=1.3", "the law 'rft3d' has no option 'scael'; it has: density, internal_f"),
        ("rft3d scale", "the option 'scale' of the law 'rft3d' needs a value: scale=..."),
        ("rft3d scale=big", "scale must be a number, not 'big'"),
        ("rft3d scale=-1", "scale must be finite and not negative, not -1.0"),
        ("rft3d scale=nan", "scale must be finite"),
        ("rft3d scale=1 scale=2", "'scale' of the law 'rft3d' is given twice"),
        ("rft3d 'scale=1", "cannot be split into words"),
        (
            "rtf3d scale=1",
            "no law 'rtf3d'; there are: depth_velocity, link, link_distributed, rft2d, "
            "rft2d_dynamic, rft3d, rft3d_dynamic; did",
        ),
    ],
)
def test_slips_in_words_are_told(law: str, said: str) -> None:
    for make in (lambda: mg.Sand(block(), law=law), lambda: read_config({"law": law})):
        with pytest.raises((InputError, UnknownNameError)) as caught:
            make()
        assert said in str(caught.value)


def test_a_law_without_constants_in_the_medium_needs_all_it_has_no_default_for() -> None:
    given = "link eta_d=1 eta_h=2 eta_v=3 exponent=1"
    assert get_law(given, mg.media["glass_beads"]) == mg.LinkLaw(1, 2, 3, 1)
    with pytest.raises(UnknownNameError, match="no constants in medium 'glass_beads' for law"):
        get_law("link eta_d=1", mg.media["glass_beads"])


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mud_of_a_test.py").write_text(MUD, encoding="utf-8")
    (tmp_path / "block.xml").write_text(BLOCK, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(mg.laws, "_things", dict(mg.laws._things))
    return tmp_path


def test_a_law_of_ones_own_on_the_command_line(
    beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    law = "mud_of_a_test:Mud stiffness=1000"
    given = ["--law", law, "--medium", "glass_beads", "--json"]
    assert main(["elements", "block.xml", *given]) == 0
    assert json.loads(capsys.readouterr().out)["law"] == "mud_of_a_test stiffness=1000"
    assert main(["list", "laws", "mud_of_a_test:Mud", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["linear"] == 5.0
    for wrong, said in (
        ("mud_of_a_test:Mudd", "did you mean Mud?"),
        ("mud_of_the_test:Mud", "did you mean mud_of_a_test?"),
        ("mud_of_a_test:Mud stifness=1", "no option 'stifness'"),
        ("mud_of_a_test:Clay linear=1", "for law 'clay_of_a_test'; there are: "),
    ):
        assert main(["elements", "block.xml", "--law", wrong]) == 2
        assert said in capsys.readouterr().err


def test_no_file_has_a_law_of_somebodys_imported(beside: Path) -> None:
    for make in (
        lambda: read_config({"law": "mud_of_a_test:Mud"}),
        lambda: mg.Sand(block(), law="mud_of_a_test:Mud"),
    ):
        with pytest.raises((InputError, UnknownNameError), match="no law 'mud_of_a_test:Mud'"):
            make()


def test_the_parameters_of_a_law_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "laws", "rft3d"]) == 0
    said = capsys.readouterr().out
    assert "scale" in said
    density = mg.media["quikrete_medium"].constants["rft3d"]["density"].value
    assert f"quikrete_medium {density:g}" in said
    assert main(["list", "laws", "rft3d", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["scale"] == 1.0


@pytest.mark.parametrize(
    ("wrong", "right", "said"),
    [
        ("density: {value: 3", "desnity: {value: 3", "has no constant 'desnity'"),
        ("    internal_f", "    # internal_f", "needs the constant 'internal_friction'"),
        (
            "rft3d",
            "rtf3d",
            "no law 'rtf3d'; there are: depth_velocity, link, link_distributed, rft2d, "
            "rft2d_dynamic, rft3d, rft3d_dynamic; did",
        ),
        ("value: 0.4", "value: -0.4", "from 0 to 2, not -0.4"),
    ],
)
def test_names_in_a_file_of_a_medium_are_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str, right: str, said: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MEDIUM.replace(wrong, right), encoding="utf-8")
    assert main(["list", "media", str(path)]) == 2
    assert said in capsys.readouterr().err


def test_constants_of_a_law_that_is_not_known_here_are_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MEDIUM.replace("rft3d", "molasses"), encoding="utf-8")
    with pytest.warns(GranularWarning, match="no law 'molasses' is known here"):
        check_constants(read_medium(path))
