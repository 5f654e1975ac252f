"""The short form of `scripts/attack.py`: random models through both interfaces."""

import importlib
import json
import os
import signal
import subprocess
import sys
from argparse import Namespace
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pytest

ATTACK = Path(__file__).resolve().parents[2] / "scripts" / "attack.py"
MODELS, STEPS = 28, 60


def attack(folder, *options, **more):
    command = [sys.executable, ATTACK, "--out", folder / "rows.jsonl", "--jobs", 2, *options]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, **more)
    rows = [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]
    return done, rows


@pytest.mark.slow
def test_random_models(tmp_path):
    """Of all kinds: only controls, legal and illegal changes in motion, changes at rest."""
    some = ("--only", "steps", "--short", "--models", MODELS, "--steps", STEPS)
    done, rows = attack(tmp_path, *some)
    assert done.returncode == 0, done.stdout + done.stderr
    assert sorted(row["case"] for row in rows) == [*range(MODELS)]
    assert sum(row["counts"].get("errors", 0) for row in rows) > 0.8 * MODELS * STEPS


# An attack of which some cases end their process: a file `deaths.py` next to the others.
DEATHS = """
import ctypes, os, signal, time
from types import SimpleNamespace
from attacks.cases import Result

DEATHS = ("pass", "os.kill(os.getpid(), signal.SIGKILL)", "ctypes.string_at(0)", "os._exit(3)",
          "time.sleep(60)", "raise KeyError", "pass")

def draw(seed, number, options):
    return DEATHS[number]

def run(case):
    exec(case)
    return Result()
"""
RUN = """
import sys
sys.path.insert(0, {scripts!r})
import attack
import attacks
attacks.__path__.append({folder!r})
attack.ATTACKS += ("deaths",)
attack.__file__ = __file__
sys.exit(attack.main())
"""


@pytest.fixture
def deaths(tmp_path):
    """A program that attacks with the cases above."""
    (tmp_path / "deaths.py").write_text(DEATHS)
    program = RUN.format(scripts=str(ATTACK.parent), folder=str(tmp_path))
    (tmp_path / "run.py").write_text(program)
    return [sys.executable, tmp_path / "run.py", "--only", "deaths", "--out", tmp_path / "rows"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_case_that_dies_or_hangs_is_a_failure_and_the_others_run(deaths, tmp_path):
    command = [*map(str, deaths), "--models", "7", "--limit", "3", "--jobs", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    rows = [json.loads(line) for line in (tmp_path / "rows").read_text().splitlines()]
    assert done.returncode == 1, done.stderr
    assert [row["case"] for row in rows] == [*range(7)]
    failures = [row["failures"] for row in rows]
    assert failures[0] == failures[6] == {}
    assert "KeyError" in failures[5]["errors"]
    for number, words in ((1, "without a message"), (2, "Segmentation fault"), (4, "Timeout")):
        assert words in failures[number]["survives"]
    assert "deaths: survives                           4         4" in done.stdout
    assert "--only deaths --seed 0 --steps 155 --case 4" in done.stdout


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_run_that_is_ended_keeps_its_report_and_prints_its_table(deaths, tmp_path):
    command = [*map(str, deaths), "--first", "4", "--models", "3", "--jobs", "1"]
    with subprocess.Popen(
        [*command, "--first", "0", "--models", "7", "--limit", "60"],
        stdout=subprocess.PIPE, text=True,
    ) as run:  # fmt: skip
        assert run.stdout is not None
        for line in run.stdout:
            if " 3, survives" in line:
                break
        os.kill(run.pid, signal.SIGTERM)
        rest = run.stdout.read()
    assert run.returncode == 143
    assert "deaths: survives" in rest
    rows = [json.loads(line) for line in (tmp_path / "rows").read_text().splitlines()]
    # More on a busy machine, until the signal comes.
    assert [row["case"] for row in rows] == [*range(max(4, len(rows)))]


def test_every_event_has_a_meaning():
    """No line of Python in the lists of events is one that can never be run."""
    motions = importlib.import_module("attacks.motions")
    lists = ("OPTIONS", "RARE_OPTIONS", "BAD_OPTIONS", "FIELDS", "BAD_FIELDS", "BAD_STATES")
    model = mujoco.MjModel.from_xml_string(EVERYTHING)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    names = {"model": model, "data": data, "mujoco": mujoco, "np": np}
    for name in lists:
        for line in getattr(motions, name):
            exec(motions.seeded(rng, line), names)
    options = Namespace(short=False, laws=None, kind=None, steps=10)
    assert motions.draw(0, 1, options) == motions.draw(0, 1, options)


def test_models_of_all_kinds_are_drawn():
    models = importlib.import_module("attacks.models")
    seen = Counter()
    for number in range(60):
        program = models.PROGRAMS[number % len(models.PROGRAMS)]
        drawn = models.draw(np.random.default_rng(number), program)
        model = mujoco.MjModel.from_xml_string(drawn.xml)
        seen.update(("joint", int(kind)) for kind in set(model.jnt_type))
        seen.update(("geom", int(kind)) for kind in set(model.geom_type))
        seen.update(("equality", int(kind)) for kind in set(model.eq_type))
        seen.update(["tendons"] * (model.ntendon > 0) + ["actuators"] * (model.nu > 0))
        seen.update(["activations"] * (model.na > 0) + ["mocap"] * (model.nmocap > 0))
        seen[("integrator", int(model.opt.integrator))] += 1
    joints, geoms = range(4), (0, 1, 2, 3, 4, 5, 6, 7)
    assert all(seen["joint", kind] for kind in joints)
    assert all(seen["geom", kind] for kind in geoms)
    assert all(seen["equality", kind] for kind in range(3))
    assert all(seen["integrator", kind] for kind in range(4))
    assert all(seen[name] for name in ("tendons", "actuators", "activations", "mocap"))


EVERYTHING = """
<mujoco>
  <asset><hfield name="h" nrow="3" ncol="3" size="1 1 0.1 0.1"/></asset>
  <worldbody>
    <geom type="hfield" hfield="h"/>
    <body name="m" mocap="true"/>
    <body name="a"><freejoint/><geom size="0.1"/>
      <body pos="0 0 0.3"><joint name="j"/><geom size="0.1"/></body>
    </body>
  </worldbody>
  <equality><weld body1="m" body2="a"/></equality>
  <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator><position joint="j" timeconst="0.1"/></actuator>
</mujoco>
"""
