"""Memory: no pose, no height, no other model has compiled code read what is not its own."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from mjgranular import HeightField, InputError, Sand, UnstableError
from mjgranular.engine import add_sand

# One of the bodies hangs on a mocap body, of whose motion the sand feels nothing.
pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.UnfeltWarning")

# A body that a mocap body carries, and one that is free; both in the dune.
DUNE = """
<mujoco>
  <option timestep="1e-3"/>
  <asset><hfield name="dune" nrow="{n}" ncol="{n}" size="1 1 0.1 0.1"/></asset>
  <worldbody>
    <geom name="dune" type="hfield" hfield="dune"/>
    <body mocap="true">
      <body name="arm"><joint axis="0 1 0"/><geom type="capsule" size="0.05 0.1"/></body>
    </body>
    <body name="rod" pos="0.3 0.3 0"><freejoint/><geom type="capsule" size="0.05 0.1"/></body>
  </worldbody>
</mujoco>
"""
NOT_THERE = (math.nan, math.inf, -math.inf, 1e300)


def given(law, scheme):
    medium = "quikrete_medium" if law == "rft3d" else "play_sand"
    return {"medium": medium, "law": law, "scheme": scheme, "surface": HeightField("dune")}


def model_of(n, **sand):
    spec = mujoco.MjSpec.from_string(DUNE.format(n=n))
    if sand:
        add_sand(spec, **sand)
    return spec.compile()


def move(model, data, how, value):
    """Puts a number where a pose, or the dune, is made of it."""
    if how == "mocap x":
        data.mocap_pos[0, 0] = value
    elif how == "mocap y":
        data.mocap_pos[0, 1] = value
    elif how == "qpos":
        data.qpos[1] = value
    elif how == "turned":
        data.qpos[0] = value
    elif how == "body_pos":
        model.body_pos[2, 0] = value
    else:
        model.hfield_data[:] = max(min(value, 3e38), -3e38) if abs(value) < math.inf else value


WAYS = ("mocap x", "mocap y", "qpos", "turned", "body_pos", "heights")


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
@pytest.mark.parametrize("law", ["link_distributed", "rft3d"])
def test_a_pose_that_is_no_number_meets_no_height_field(law, scheme, how):
    for value in NOT_THERE:
        model = model_of(65)
        sand = Sand(model, **given(law, scheme))
        for act in (sand.step, sand.report, sand.apply):
            data = mujoco.MjData(model)
            move(model, data, how, value)
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            # What is there, but far away, is not in the sand: then all is well.
            if math.isnan(value) and how != "qpos":
                with pytest.raises(UnstableError):
                    act(data)
                continue
            try:
                act(data)
            except UnstableError:
                continue
            assert np.isfinite(data.qacc).all()
            assert np.isfinite(data.xfrc_applied).all()


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
@pytest.mark.parametrize("law", ["link_distributed", "rft3d"])
def test_nor_within_the_engine(law, scheme, how, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file
    for value in NOT_THERE:
        model = model_of(65, **given(law, scheme))
        data = mujoco.MjData(model)
        move(model, data, how, value)
        mujoco.mj_forward(model, data)
        for _ in range(2):
            mujoco.mj_step(model, data)
        if how not in ("body_pos", "heights"):  # MuJoCo finds what is no number, and resets
            assert np.isfinite(data.qpos).all()
            assert np.isfinite(data.qacc).all()


def run(folder, code, *arguments, **environment):
    file = folder / "code.py"
    file.write_text(code, encoding="utf-8")
    places = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.run(
        [sys.executable, str(file), *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(places), **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )


class TestAnotherModel:
    """A batch, or a loop of the user's, may run an MjData on a model that it was not made for."""

    ARGUMENTS = given("link_distributed", "explicit")

    def test_of_the_same_rows_and_columns(self):
        own, other = model_of(9, **self.ARGUMENTS), model_of(9, **self.ARGUMENTS)
        other.hfield_data[:] = 1.0
        data, deep = mujoco.MjData(own), mujoco.MjData(other)
        data.qvel[1:4] = deep.qvel[1:4] = -1.0
        mujoco.mj_forward(own, data)
        shallow = data.qfrc_passive.copy()
        mujoco.mj_forward(other, data)
        mujoco.mj_forward(other, deep)
        assert (data.qfrc_passive == deep.qfrc_passive).all()
        assert (data.qfrc_passive != shallow).any()

    def test_of_others_is_refused(self):
        own, other = model_of(2000, **self.ARGUMENTS), model_of(3, **self.ARGUMENTS)
        data = mujoco.MjData(own)
        with pytest.raises(mujoco.FatalError, match="other rows or columns in this model"):
            mujoco.mj_step(other, data)
        mujoco.mj_step(own, data)

    def test_in_a_batch(self):
        own, other = model_of(9, **self.ARGUMENTS), model_of(8, **self.ARGUMENTS)
        batch = Batch(own, 2, nthread=1)
        batch.set_models([own, other])
        with pytest.raises(RuntimeError, match="other rows or columns in this model"):
            batch.step()


def test_a_height_field_that_is_longer_than_its_data():
    model = model_of(9)
    model.hfield_nrow[0] = 10_000
    with pytest.raises(InputError, match="too many for hfield_data"):
        Sand(model, **given("link_distributed", "explicit"))


CROWD = """
<mujoco>
  <option timestep="0.002" cone="{cone}" jacobian="{jacobian}" integrator="{integrator}"/>
  <default><joint damping="0.1" frictionloss="0.01"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1" pos="0 0 -0.1"/>
    {bodies}
  </worldbody>
</mujoco>
"""
HINGED = """
<body pos="{x} 0 -0.072">
  <freejoint/><geom type="capsule" size="0.03 0.1" euler="0 80 0"/>
  <body pos="0 0.2 0">
    <joint axis="1 0 0" range="-10 -5" limited="true"/><geom type="capsule" size="0.03 0.06"/>
  </body>
</body>
"""


# The arrays of a workspace, with an index that is off in none: `NUMBA_BOUNDSCHECK`.
WORKSPACE = """
from test_memory_bounds import *

for cone, jacobian, integrator, count in (
    ("elliptic", "dense", "Euler", 10), ("pyramidal", "sparse", "implicitfast", 3),
):
    bodies = "".join(HINGED.format(x=0.4 * k) for k in range(count))
    given = {"cone": cone, "jacobian": jacobian, "integrator": integrator}
    model = mujoco.MjModel.from_xml_string(CROWD.format(bodies=bodies, **given))
    sand, data = Sand(model, law="link", scheme="implicit"), mujoco.MjData(model)
    rows = 0
    for _ in range(20):
        sand.step(data)
        rows = max(rows, data.nefc)
    print(rows > 64, sand.report(data).solver.steps)
"""


@pytest.mark.slow
def test_the_implicit_scheme_stays_within_its_arrays(tmp_path):
    checked = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = run(tmp_path, WORKSPACE, **checked)
    assert (done.returncode, done.stdout.split()) == (0, ["True", "20", "False", "20"]), done.stderr


# With bounds checks. One program for each way to read: the first number is read by itself,
# the others as vectors are. After each, the last index that is right.
KINDS = {
    "numbers[index]": 7,
    "read_column(numbers, index)[1]": 4,
    "total_of(read_four(numbers, index)[0])": 4,
    "numbers[index + len(read_rows(numbers, index))]": 4,
}
FAULTY = """
import sys
import numpy as np
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.fields import column, rows
from mjgranular.kernel.lanes import total_of
from mjgranular.kernel.memory import floats

read_column, read_rows, read_four = column(2, 3).read, rows(2, 2).read, rows(1, 4).read
room = np.arange(1000.0)

def answer(look, index):
    try:
        entry(look, "int64(int64, int64)")(room.ctypes.data, index)
    except IndexError as error:
        return error
    return "read"
"""
LOOK = """
@compiled
def part_{number}(address, index):
    numbers = floats(address, 8)
    return {kind}

@compiled
def look_{number}(address, index):
    return np.int64(part_{number}(address, index))

print(answer(look_{number}, {last}), answer(look_{number}, {last} + 1), sep="; ")
"""


@pytest.mark.slow
def test_bounds_checks_are_alive(tmp_path):
    looks = [
        LOOK.format(number=number, kind=kind, last=last)
        for number, (kind, last) in enumerate(KINDS.items())
    ]
    code = FAULTY + "".join(looks)
    # The programs without checks are others, also on disk.
    for checks, beyond in (("1", "index is out of bounds"), ("0", "read")):
        done = run(tmp_path, code, NUMBA_BOUNDSCHECK=checks, NUMBA_CACHE_DIR=str(tmp_path))
        assert done.stdout.splitlines() == [f"read; {beyond}"] * len(KINDS), done.stderr


WITHIN = """
import numpy as np
import mujoco
from dataclasses import dataclass
from typing import Any, ClassVar
from mjgranular import Plane
from mjgranular.engine import add_sand
from mjgranular.engine.config import surfaces
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector
from mjgranular.surface import Surface

@compiled
def probe(record, point):
    index = 3 if 0.15 < -point.z < 0.25 else 0  # not where normals are checked
    return record.normal[np.int64(index + 0 * point.x)] - point.z, vector(0.0, 0.0, 1.0)

@dataclass(frozen=True)
class Faulty(Surface):
    probe: ClassVar[Any] = probe

    def record(self, model):
        return Plane().record(model)

    def tilt(self, model):
        return 0.0

surfaces.add("faulty", Faulty)
spec = mujoco.MjSpec.from_string(
    "<mujoco><statistic extent='1'/><worldbody><body><freejoint/>"
    "<geom type='capsule' size='.1 .1'/></body></worldbody></mujoco>"
)
add_sand(spec, surface=Faulty(), law="depth_velocity linear=1", scheme="explicit")
model = spec.compile()
try:
    mujoco.mj_step(model, mujoco.MjData(model))
except BaseException:
    pass
print("nobody saw it")
"""


@pytest.mark.slow
def test_within_the_engine_they_are_reported(tmp_path):
    done = run(tmp_path, WITHIN, NUMBA_BOUNDSCHECK="1")
    assert "IndexError: index is out of bounds" in done.stderr
