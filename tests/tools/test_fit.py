"""`mjgranular fit`: the contract of the command, what it writes, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from mjgranular import DepthVelocityLaw, DynamicRft3dLaw, Sand
from mjgranular.cli import main
from mjgranular.law import get_law
from mjgranular.medium import get_medium

MEDIUM = "{density: 1500, stiffness: 50, quadratic: 0.5}"
BALL = "{shape: sphere, diameter: 0.0254, mass: 0.0692}"
FREE = ["--law", "depth_velocity", "--free", "stiffness", "quadratic"]


def curve(speed, rows=40):
    """Depth [m] of 69.2 g with nothing but friction of 2 N, which everybody can do in the head."""
    slow = 2.0 / 0.0692 - 9.81
    t = np.linspace(0.0, 1.3 * speed / slow, rows)
    s = np.minimum(t, speed / slow)
    return t, speed * s - slow * s**2 / 2


def write(path, columns):
    names = ",".join(columns)
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([names, *rows]) + "\n")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Two drops and a file of runs, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for name, speed in (("slow", 1.0), ("fast", 2.5)):
        t, depth = curve(speed)
        write(tmp_path / f"{name}.csv", {"time": t, "depth": depth})
    runs(tmp_path)
    return tmp_path


def runs(place, medium=MEDIUM, slow="", name="slow"):
    """Writes the file; `slow` are further keys of the first run."""
    (place / "runs.yaml").write_text(
        f"medium: {medium}\nruns:\n"
        f"  - {{name: {name}, kind: drop, body: {BALL}, speed: 1.0, data: slow.csv{slow}}}\n"
        f"  - {{name: fast, kind: drop, body: {BALL}, speed: 2.5, data: fast.csv}}\n"
    )


def refused(capsys, *arguments):
    """The sentence with which the command refuses."""
    status = main(["fit", "runs.yaml", *arguments])
    out, err = capsys.readouterr()
    assert status == 2, out
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def test_one_object(place, capsys):
    law = ["--law", "depth_velocity", "--free", "constant", "--hold-out", "fast", "--json"]
    runs(place, "{density: 1500, constant: 1}")
    assert main(["fit", "runs.yaml", *law]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["values"]["constant"] == pytest.approx(2.0, rel=2e-3)
    low, high = found["intervals"]["constant"]
    assert low <= found["values"]["constant"] <= high
    assert found["correlations"] == {"constant": {}}
    assert found["identifiable"] == {"constant": True}
    assert list(found["runs"]) == ["slow"]
    assert list(found["held_out"]) == ["fast"]
    for errors in (found["runs"]["slow"], found["held_out"]["fast"]):
        assert abs(errors["depth"]) < 0.005
        assert abs(errors["stopping_time"]) < 0.03
        assert errors["trajectory"] < 0.005
    assert {path.name for path in place.iterdir()} == {"runs.yaml", "slow.csv", "fast.csv"}


def test_a_medium_that_sand_takes(place, capsys):
    runs(place, "{density: 1500, grain: 0.0003, constant: 1, title: 'A tray, of my own: mine'}")
    command = ["fit", "runs.yaml", "--law", "depth_velocity", "--free", "strength", "--out"]
    assert main([*command, "tray.yaml"]) == 0
    shown = capsys.readouterr().out
    assert "written to tray.yaml" in shown
    medium = get_medium("tray.yaml")
    assert medium.name == "tray"
    assert medium.title == "A tray, of my own: mine"
    law = get_law(None, medium)
    assert isinstance(law, DepthVelocityLaw)
    assert law.constant == pytest.approx(2.0, rel=2e-3)
    source = medium.constants["depth_velocity"]["constant"].source
    assert "runs.yaml (slow, fast)" in source
    assert "95 % interval" in source
    with Image.open(place / "tray.fit.png") as figure:
        assert figure.size[0] > 500
    # Nothing that is there is lost.
    before = (place / "tray.yaml").read_bytes()
    message = refused(capsys, *command[2:], "tray.yaml")
    assert "--overwrite" in message
    assert (place / "tray.yaml").read_bytes() == before
    assert main([*command, "tray.yaml", "--overwrite"]) == 0


def test_a_medium_of_rft3d_carries_the_strength(place, model_of_a_ball, capsys):
    medium = "{base: quikrete_medium, surface_friction: 0.3}"
    runs(place, medium)
    command = ["fit", "runs.yaml", "--free", "strength", "--hold-out", "fast", "--out", "m.yaml"]
    assert main([*command, "--json"]) == 0
    strength = json.loads(capsys.readouterr().out)["values"]["strength"]
    constants = get_medium("m.yaml").constants["rft3d_dynamic"]
    assert constants["surface_friction"].value == 0.3
    assert constants["internal_friction"].source == (
        get_medium("quikrete_medium").constants["rft3d"]["internal_friction"].source
    )
    sand = Sand(model_of_a_ball, medium="m.yaml")
    before = DynamicRft3dLaw.from_medium("quikrete_medium").scale
    assert sand.law.scale == pytest.approx(strength * before)
    assert strength != 1.0


@pytest.fixture
def model_of_a_ball():
    from mjgranular.models import Projectile

    return Projectile(0.0254, 0.0254, 8000.0, "sphere").model(1e-4)


UNITS = {"mm": ("depth", 1e3), "cm": ("depth", 1e2), "ms": ("time", 1e3)}


@pytest.mark.parametrize("unit", UNITS)
def test_units_that_cannot_be(unit, place, capsys):
    column, factor = UNITS[unit]
    columns = dict(zip(("time", "depth"), curve(1.0), strict=True))
    write(place / "slow.csv", columns | {column: factor * columns[column]})
    assert "is implausible: name units" in refused(capsys, *FREE)
    text = (place / "slow.csv").read_text().replace(column, f"{column} [{unit}]", 1)
    (place / "slow.csv").write_text(text)
    assert main(["fit", "runs.yaml", *FREE]) == 0


def changed(**columns):
    def change(place):
        t, depth = curve(1.0)
        found = {"time": t, "depth": depth}
        found |= {name: make(t, depth) for name, make in columns.items()}
        write(place / "slow.csv", {k: v for k, v in found.items() if v is not None})

    return change


def back(t, depth):
    t = t.copy()
    t[20] = t[18]
    return t


DATA = {
    "no column 'depth'": changed(depth=lambda t, d: None, level=lambda t, d: d),
    "row 21": changed(time=back),
    "no contact": changed(depth=lambda t, d: -1e-3 - d),
    "depths are positive downward": changed(depth=lambda t, d: 1e-3 - d),
    "columns are separated by commas": lambda place: (place / "slow.csv").write_text(
        "time;depth\n0;0\n0,01;1\n"
    ),
    "at least 4 rows": lambda place: (place / "slow.csv").write_text(
        "time,depth\n0,0\n0.01,0.01\n"
    ),
    "'x'": lambda place: (place / "slow.csv").write_text("time,depth\n0,0\n0.01,x\n"),
    "'in'": lambda place: (place / "slow.csv").write_text("time [s],depth [in]\n0,0\n0.01,1\n"),
    "2 columns 'depth'": lambda place: (place / "slow.csv").write_text(
        "time,depth [mm],depth_m\n0,0,0\n0.01,1,2\n"
    ),
    "begins with numbers": lambda place: (place / "slow.csv").write_text("0,0\n0.01,1\n"),
    "more cells than headings": lambda place: (place / "slow.csv").write_text(
        "time,depth\n0,0,0,0\n0,01,0,001\n"  # decimal commas: 1 and 0 without this error
    ),
    "a quote may not be closed": lambda place: (place / "slow.csv").write_text(
        'time,depth\n"0,0\n' + "0.01,1\n" * 20_000
    ),
    "is not a text file": lambda place: (place / "slow.csv").write_text(
        "time;depth\n0;0\n0.01;1\n", encoding="utf-16"
    ),
    "slow.csv": lambda place: (place / "slow.csv").unlink(),
}


def test_a_switch_of_the_law_is_in_the_medium(place):
    runs(place, "{base: quikrete_medium}")
    command = ["fit", "runs.yaml", "--free", "strength", "--hold-out", "fast", "--out", "m.yaml"]
    assert main([*command, "--law", "rft3d_dynamic rise=true"]) == 0
    assert get_law(None, get_medium("m.yaml")).rise is True


@pytest.mark.parametrize("said", DATA)
def test_data_that_cannot_be(said, place, capsys):
    DATA[said](place)
    assert said in refused(capsys, *FREE, "--out", "m.yaml")
    assert not (place / "m.yaml").exists()


@pytest.mark.parametrize("wrong", ["mass: 69.2", "diameter: 25.4", "diameter: 0.0127"])
def test_a_body_that_no_material_makes(wrong, place, capsys):
    text = (place / "runs.yaml").read_text()
    key = wrong.split(":")[0]
    right = {"mass": "mass: 0.0692", "diameter": "diameter: 0.0254"}[key]
    (place / "runs.yaml").write_text(text.replace(right, wrong, 1))
    assert main(["fit", "runs.yaml", *FREE]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "warning: run 'slow': the sphere has" in said
    assert "mass is in kg" in said


def pushed(place, rows, **keys):
    """Writes a file of one push or drag of a plate of 40 mm."""
    keys = {"name": "plate", "kind": "intrude", "data": "plate.csv"} | keys
    more = "".join(f", {key}: {value}" for key, value in keys.items())
    body = "{shape: plate, length: 0.04, diameter: 0.004}"
    (place / "runs.yaml").write_text(f"medium: {MEDIUM}\nruns:\n  - {{body: {body}{more}}}\n")
    (place / "plate.csv").write_text(rows)


def test_a_push_whose_depths_are_negative(place, capsys):
    pushed(place, "depth,force\n-0.01,1\n-0.02,2\n")
    assert "got no contact; depths there are positive" in refused(capsys, *FREE)


def test_units_of_a_push(place, capsys):
    pushed(place, "depth,force\n2,1\n5,2\n")
    assert "name the unit of a column, such as 'depth [mm]'" in refused(capsys, *FREE)
    pushed(place, "speed,force\n0.1,1\n0.2,2\n", kind="drag", depth=4.5)
    assert "the key depth is in m" in refused(capsys, *FREE)
    pushed(place, "depth,force [g]\n0.01,1\n0.02,2\n")
    assert "must be in one of N, mN, kN" in refused(capsys, *FREE)
    pushed(place, "depth,force_mN\n0.01,500\n0.02,1000\n0.03,1500\n")
    assert main(["fit", "runs.yaml", "--law", "depth_velocity", "--free", "stiffness"]) == 0
    assert "50" in capsys.readouterr().out


def test_a_column_that_occurs_twice(place, capsys):
    t, depth = curve(1.0)
    write(place / "slow.csv", {"time": t, "depth": depth, "depth [mm]": depth})
    assert "slow.csv has 2 columns 'depth': rename one" in refused(capsys, *FREE)


OPTIONS = {
    "'stifness'; there are: strength": (
        "--law", "depth_velocity", "--free", "stifness",
    ),
    "no constant is free": ("--law", "depth_velocity"),
    "named twice": ("--law", "depth_velocity", "--free", "stiffness", "stiffness"),
    "one of strength and stiffness": (
        "--law", "depth_velocity", "--free", "strength", "stiffness",
    ),
    "'quick'; there are: slow, fast": (*FREE, "--hold-out", "quick"),
    "no run to fit to": (*FREE, "--hold-out", "slow", "fast"),
    "linear starts at 0": (
        "--law", "depth_velocity linear=0", "--free", "linear", "stiffness",
    ),
    "4 constants are free": (
        "--law", "depth_velocity", "--hold-out", "fast", "--free", "stiffness", "quadratic",
        "linear", "exponent",
    ),
    "'rft4d'": ("--law", "rft4d", "--free", "strength"),
    "name the law": ("--free", "strength"),
    "--out must be a file that ends in .yaml": (*FREE, "--out", "medium.json"),
    "must not be the file of the runs": (*FREE, "--out", "runs.yaml", "--overwrite"),
    "there is no folder": (*FREE, "--out", "no/medium.yaml"),
}  # fmt: skip


@pytest.mark.parametrize("said", OPTIONS)
def test_options_that_cannot_be(said, place, capsys):
    assert said in refused(capsys, *OPTIONS[said])


FILES = {
    "no key 'densty'": {"medium": "{density: 1500, densty: 1}"},
    "density": {"medium": "{stiffness: 50}"},
    "'50 N/m'": {"medium": "{density: 1500, stiffness: 50 N/m}"},
    "'beach'": {"medium": "{base: beach}"},
    "from 10 to 25000": {"medium": "{density: 1.5, stiffness: 50}"},
    "runs[0] has no key 'sped'": {"slow": ", sped: 1"},
    "'fast'": {"name": "fast"},
    "not both": {"slow": ", height: 0.1"},
}


@pytest.mark.parametrize("said", FILES)
def test_files_that_cannot_be(said, place, capsys):
    runs(place, **FILES[said])
    assert said in refused(capsys, *FREE)


def test_a_file_that_is_none(place, capsys):
    (place / "runs.yaml").write_text("runs: [")
    assert "is not YAML" in refused(capsys, *FREE)
    (place / "runs.yaml").write_text("medium: {base: glass_beads}\n")
    assert "needs runs" in refused(capsys, *FREE)


def test_a_law_without_a_start_finds_one(place, capsys):
    """Inertia and its like are 0 where nobody has said: that is a bound, and no start."""
    runs(place, "{density: 1500, constant: 1}")
    command = ["--law", "depth_velocity", "--free", "constant", "linear", "--json"]
    assert main(["fit", "runs.yaml", *command]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["values"]["constant"] == pytest.approx(2.0, rel=0.02)
    assert found["values"]["linear"] == pytest.approx(0.0, abs=0.02)
