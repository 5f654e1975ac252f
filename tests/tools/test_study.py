"""Studies: any fields of an experiment varied, on a grid."""

import csv
import itertools
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mjgranular.cli import main
from mjgranular.cli.sweep import read_experiment, read_vary
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.experiment import Drop, Impact, Study, run_impact, run_study
from mjgranular.experiment.intrusion import Intrusion
from mjgranular.experiment.study import with_values
from mjgranular.medium import get_medium

QUICK = Impact(speed=2.0, timestep=1e-4, duration=0.05)
FEW = ["--of", "impact --timestep 1e-4 --duration 0.05", "--workers", "1"]
BALL = """
<mujoco><worldbody><body name="ball" pos="0 0 0.03"><freejoint/>
<geom name="ball" type="sphere" size="0.02" density="2000"/></body></worldbody></mujoco>
"""


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


# What is varied


def test_a_grid_has_every_value_with_every_other():
    study = Study(QUICK, {"speed": np.linspace(1, 3, 3), "angle": [0.5, 0.7]})
    expected = itertools.product((1.0, 2.0, 3.0), (0.5, 0.7))
    assert [tuple(study[k].values()) for k in range(len(study))] == list(expected)
    assert study.at(5) == Impact(speed=3.0, angle=0.7, timestep=1e-4, duration=0.05)


def test_parameters_of_the_law_and_density_of_the_medium():
    changed = with_values(QUICK, {"law.eta_v": 20.0, "medium.density": 1600})
    assert changed.medium == "play_sand density=1600"
    assert get_medium(changed.medium).density.value == 1600.0
    assert changed.law == "link eta_v=20.0"
    # All forces of the link law are proportional to the density, and so to each of its constants:
    # twice the density is twice all of them.
    constants = get_medium("play_sand").constants_for("link")
    words = {f"law.{key}": 2 * constants[key] for key in ("eta_d", "eta_h", "eta_v")}
    one = run_impact(with_values(QUICK, words)).summary()
    other = run_impact(with_values(QUICK, {"medium.density": 5000.0})).summary()
    assert one["stopping_time"] == pytest.approx(other["stopping_time"], rel=1e-9)
    assert one["depth"] == pytest.approx(other["depth"], rel=1e-9)


def test_a_row_is_what_its_experiment_gives_alone():
    study = Study(QUICK, {"speed": [1.0, 2.0], "diameter": [0.01, 0.02]})
    result = run_study(study, workers=1)
    for index, row in enumerate(result.rows()):
        alone = run_impact(study.at(index)).summary()
        assert {name: row[name] for name in alone} == alone
    assert result.finished == 4
    assert (result.failed, result.interrupted) == (0, False)


@pytest.mark.parametrize(
    ("vary", "words"),
    [
        ({}, "varies something"),
        ({"sped": [1.0]}, "no field to vary 'sped'; .*did you mean speed"),
        ({"model": ["a"]}, "no field to vary 'model'"),
        ({"speed": [1.0, -1.0]}, "must not be negative"),
        ({"speed": []}, "at least one value"),
        ({"speed": ["fast"]}, "speed .*'fast'"),
        ({"speed": [math.nan]}, "finite"),
        ({"speed": 3.0}, "a list of values"),
        ({"angle": [0.1, 2.0]}, "less than 90"),
        ({"law.eta": [1.0]}, "no parameter of the law link 'eta'"),
        ({"law": ["mud"]}, "no law 'mud'"),
        ({"medium.grain": [1.0]}, "medium.density"),
        ({"medium.density": [1.0]}, "bulk density"),
    ],
)
def test_mistakes_in_what_is_varied(vary, words):
    with pytest.raises((InputError, UnknownNameError), match=words):
        Study(QUICK, vary)


def test_other_mistakes():
    with pytest.raises(InputError, match="Impact, a Drop or an Intrusion"):
        Study("block.xml", {"speed": [1.0]})
    with pytest.raises(InputError, match=r"points .*10\.5"):
        Study(Intrusion(), {"points": [10, 10.5]})
    with pytest.raises(InputError, match="both determine the end"):
        Study(Intrusion(distance=0.03), {"depth": [0.02, 0.05]})
    with pytest.raises(InputError, match="omit --model or --size"):
        Study(Intrusion(model=Path("foot.xml")), {"size": [0.02, 0.05]})
    with pytest.raises(InputError, match="name the law"):
        with_values(Drop(Path("robot.xml")), {"law.scale": 1.0})
    with pytest.raises(InputError, match="behind a medium's name"):
        get_medium("play_sand grain=1e-3")


# On the command line


def test_words_of_a_grid():
    found = read_vary(["speed=1:10:4", "angle=30,60", "law=link,rft2d"])
    assert found["speed"] == [1.0, 4.0, 7.0, 10.0]
    assert found["angle"] == [math.radians(30), math.radians(60)]
    assert found["law"] == ["link", "rft2d"]
    assert read_experiment("intrude --intruder sphere --tilt 90").tilt == math.radians(90)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vary", "speed"], "NAME=FIRST:LAST:COUNT"),
        (["--vary", "speed=1:2"], "FIRST:LAST:COUNT"),
        (["--vary", "speed=2:2:3"], "differ"),
        (["--vary", "speed=1:2:1"], "2 to"),
        (["--vary", "speed=1:2:3:4"], "FIRST:LAST:COUNT"),
        (["--vary", "speed=1,2", "speed=3"], "varied twice"),
        (["--vary", "speed=1,,2"], "empty value"),
        (["--vary", "speed=1,2", "--of", "train x"], "no experiment to sweep 'train'"),
        (["--vary", "speed=1,2", "--of", "impact --json"], "omit it in --of"),
        (["--vary", "speed=1,2", "--of", "drop nowhere.xml"], "no field to vary 'speed'"),
        (["--vary", "height=1,2", "--of", "drop nowhere.xml"], "nowhere.xml"),
        (["--address", "auto"], "say --engine ray too"),
    ],
)
def test_mistakes_on_the_command_line(arguments, words, tmp_path, capfd):
    out = tmp_path / "run"
    assert main(["sweep", *arguments, "--workers", "1", "--out", str(out)]) == 2
    assert words in " ".join(capfd.readouterr().err.split())
    assert not out.exists()


def test_a_grid_of_two_fields_is_written_and_drawn(tmp_path, capfd):
    out = tmp_path / "run"
    command = ["sweep", "--vary", "speed=1:2:2", "angle=30,45", *FEW]
    assert main([*command, "--out", str(out)]) == 0
    assert "30.0" not in capfd.readouterr().err
    names = {path.name for path in out.iterdir()}
    assert names == {"config.json", "summary.json", "sweep.csv", "sweep.png"}
    rows = table(out / "sweep.csv")
    assert list(rows[0])[:2] == ["speed", "angle_deg"]
    assert [(row["speed"], row["angle_deg"]) for row in rows] == [
        *(("1.0", "30.0"), ("1.0", "45.0"), ("2.0", "30.0"), ("2.0", "45.0"))
    ]
    assert json.loads((out / "summary.json").read_text())["finished"] == 4
    assert main([*command, "--out", str(out)]) == 2  # it is finished
    assert "holds a result already" in capfd.readouterr().err
    assert main([*command, "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert [row["depth"] for row in told] == [float(row["depth"]) for row in rows]


def test_an_unfinished_one_of_another_model_is_named(tmp_path):
    from mjgranular.experiment import journal_of

    model = tmp_path / "ball.xml"
    faults = []
    for radius in (0.02, 0.03):
        model.write_text(
            "<mujoco><worldbody><body><freejoint/>"
            f"<geom size='{radius}'/></body></worldbody></mujoco>"
        )
        journal = journal_of(Study(Drop(model), {"velocity": [1.0]}), tmp_path)
        faults.append(journal.fault())
        journal.keep(0, {"depth": 0.01})
        journal.close()
    assert faults[1] == "it was begun with another model, law or medium"


def test_an_unfinished_one_goes_on_and_another_does_not(tmp_path, capfd):
    from mjgranular.experiment import journal_of

    command = ["sweep", "--vary", "speed=1:2:3", *FEW, "--out", str(tmp_path)]
    study = Study(replace(QUICK, speed=Impact.speed), {"speed": [1.0, 1.5, 2.0]})
    marked = {**run_study(Study(QUICK, {"speed": [1.5]}), workers=1).journal[0], "depth": -1.0}
    journal = journal_of(study, tmp_path)
    journal.keep(1, marked)
    journal.close()
    other = ["sweep", "--vary", "speed=1:3:3", *FEW, "--out", str(tmp_path)]
    assert main(other) == 2
    assert "begun with another vary" in capfd.readouterr().err
    assert main(command) == 0
    assert "1 of 3 are finished" in capfd.readouterr().err
    assert [float(row["depth"]) > 0 for row in table(tmp_path / "sweep.csv")] == [
        True,
        False,  # not computed again
        True,
    ]


def test_a_run_that_fails_is_named_with_its_values_and_the_rest_is_there(tmp_path, capfd):
    # Explicit, with a step of 20 ms, at 5 m/s: unstable.
    command = [
        "sweep",
        "--vary",
        "timestep=1e-4,2e-2",
        "--of",
        "impact --speed 9",
        "--workers",
        "1",
    ]
    assert main([*command, "--out", str(tmp_path / "run")]) == 2
    error = " ".join(capfd.readouterr().err.split())
    assert "number 1 (timestep=0.02): the run was stopped" in error
    assert len(table(tmp_path / "run" / "sweep.csv")) == 1
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["failed"], summary["lost"]) == (1, 0)
    assert summary["failures"][0].startswith("number 1 (timestep=0.02)")


def test_a_model_and_an_intruder_are_swept(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(BALL)
    drop = ["--of", "drop ball.xml --duration 0.02", "--vary", "velocity=0,1", "slope=5,10"]
    assert main(["sweep", *drop, "--workers", "1", "--out", "a"]) == 0
    rows = table(Path("a/sweep.csv"))
    assert len(rows) == 4
    assert float(rows[0]["ball: greatest_depth"]) == float(rows[0]["greatest_depth"])
    assert [float(row["slope_deg"]) for row in rows] == [5, 10, 5, 10]
    into = ["--of", "intrude --intruder sphere --depth 0.02 --points 3", "--vary"]
    assert main(["sweep", *into, "size=0.02,0.04", "--workers", "1", "--json"]) == 0
    told = json.loads(capfd.readouterr().out.partition("written to a")[2])
    assert told[0]["resistance"] < told[1]["resistance"]


OWN = """
from dataclasses import dataclass
from mjgranular.law.link import LinkLaw

@dataclass(frozen=True)
class Mud(LinkLaw):
    name = "mud"
"""


@pytest.mark.slow
def test_a_law_of_ones_own_acts_in_worker_processes(tmp_path):
    (tmp_path / "my_mud.py").write_text(OWN)
    constants = get_medium("play_sand").constants_for("link")
    words = " ".join(f"{key}={value}" for key, value in constants.items())
    command = [sys.executable, "-m", "mjgranular", "sweep", "--json", "--workers", "2"]

    def depths(law):
        told = subprocess.run(
            [*command, "--of", f"{FEW[1]} --law '{law}'", "--vary", "speed=1,2"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        return [row["depth"] for row in json.loads(told.stdout)]

    assert depths(f"my_mud:Mud {words}") == depths("link")


def test_a_law_of_a_script_is_refused(monkeypatch):
    from mjgranular.experiment.study import custom_of
    from mjgranular.law import laws
    from mjgranular.law.link import LinkLaw

    mud = type("Mud", (LinkLaw,), {"name": "mud", "__module__": "__main__"})
    monkeypatch.setitem(laws._things, "mud", mud)
    study = Study(Impact(law="mud eta_d=1 eta_h=1 eta_v=1"), {"speed": [1.0]})
    with pytest.raises(InputError, match="put it into a module"):
        custom_of(study)
