"""The short form of `scripts/attack.py`: random models through both doors."""

import importlib
import signal
from collections import Counter

import mujoco
import numpy as np
import pytest

MODELS, STEPS = 96, 60
# Each is compiled once on a machine; the long form has all laws on all surfaces.
PROGRAMS = (
    ("link_distributed", "plane", "implicit"),
    ("rft3d", "plane", "implicit"),
    ("rft3d", "height_field", "implicit"),
    ("link", "bed", "implicit"),
    ("rft3d_dynamic", "plane", "implicit"),
    ("rft3d_dynamic", "plane memory", "implicit"),
    ("link_distributed", "plane", "explicit"),
    ("rft3d", "plane", "explicit"),
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "options", "hostile", "rest"])
def test_random_models(kind):
    common = {"seed": 0, "steps": STEPS, "programs": PROGRAMS, "kind": kind, "bare": False}
    cases = [{**common, "number": number} for number in range(MODELS // 4)]
    failures, steps, walked = [], 0, 0
    for number, result in importlib.import_module("attacks.worker").run("attacks.walk", cases, 2):
        steps, walked = steps + result.counts.get("steps", 0), walked + 1
        failures += [f"seed 0, {number}: {found}" for found in result.findings if found.failed]
    assert walked == len(cases)
    assert steps > 0.4 * MODELS // 4 * STEPS
    assert not failures, "\n".join(failures)


DEATHS = """
import ctypes, os, signal, time
from attacks.worker import Result
PATIENCE = 3.0

def attempt(case, note):
    note(f"at {case['how']}")
    exec(case["how"])
    return Result(counts={"fine": 1})
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_worker_that_dies_or_hangs_is_a_finding_and_the_rest_goes_on(tmp_path, monkeypatch):
    (tmp_path / "deaths.py").write_text(DEATHS)
    monkeypatch.syspath_prepend(tmp_path)
    deaths = {
        "os.kill(os.getpid(), signal.SIGKILL)": "SIGKILL",
        "ctypes.string_at(0)": "SIGSEGV",
        "os._exit(3)": "exit code 3",
        "time.sleep(60)": "hangs",
        "raise KeyError": "the attack itself",
    }
    lines = ["pass", *(line for death in deaths for line in (death, "pass"))]
    run = importlib.import_module("attacks.worker").run
    found = {}
    for index, result in run("deaths", [{"how": line} for line in lines], 2):
        assert result.counts == ({"fine": 1} if lines[index] == "pass" else {})
        for finding in result.findings:
            assert finding.failed
            assert finding.where in ("", f"at {lines[index]}")
            found[lines[index]] = finding.kind
    assert found == deaths


def test_every_event_can_happen():
    """No line of Python in the lists of events is one that can never be run."""
    changes = importlib.import_module("attacks.changes")
    draw = importlib.import_module("attacks.draw").draw
    lists = ("OPTIONS", "RARE_OPTIONS", "BAD_OPTIONS", "FIELDS", "BAD_FIELDS", "BAD_STATES")
    model = mujoco.MjModel.from_xml_string(EVERYTHING)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    names = {"model": model, "data": data, "mujoco": mujoco, "np": np}
    for name in (*lists, "CALM_FLAGS"):
        for line in getattr(changes, name):
            exec(changes.seeded(rng, line), names)
    assert draw(0, 1, 10) == draw(0, 1, 10)


def test_what_is_drawn_is_of_all_kinds():
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
