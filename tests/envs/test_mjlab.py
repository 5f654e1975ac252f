"""Tasks of mjlab on sand, on MuJoCo Warp's CPU back end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco_warp")
pytest.importorskip("tensordict", reason="the extra warp is not installed")
pytest.importorskip("prettytable", reason="the extra mjlab is not installed")

ROOT = Path(__file__).resolve().parents[2]

CODE = """
import copy
import sys
import types
import warnings

sys.modules["wandb"] = types.ModuleType("wandb")  # only logs need it
import go1_on_sand
import mujoco
import torch
import warp as wp
from mjlab.envs import ManagerBasedRlEnv
from mjlab.sensor import ContactMatch, ContactSensorCfg
from mjlab.sim import MujocoCfg
from mjlab.tasks.registry import load_env_cfg

from mjgranular import InputError
from mjgranular.errors import UnfeltWarning
from mjgranular.envs.mjlab import on_sand, sand_of

wp.config.log_level = wp.LOG_ERROR
torch.manual_seed(0)
cfg = load_env_cfg("Sand-Go1")
cfg.scene.num_envs = 3
cfg.events.pop("push_robot")
feet = next(sensor for sensor in cfg.scene.sensors if sensor.name == "feet_ground_contact")
robot = ContactMatch(mode="subtree", pattern="trunk", entity="robot")
fields = ("found", "force", "dist", "normal", "tangent")
cfg.scene.sensors += (
    ContactSensorCfg(name="all", primary=robot, fields=fields, global_frame=True),
    ContactSensorCfg(name="sum", primary=robot, fields=(*fields, "pos"), reduce="netforce"),
    ContactSensorCfg(name="itself", primary=robot, secondary=robot, fields=("found", "force")),
)
touch = {"name": "sole", "type": mujoco.mjtSensor.mjSENS_TOUCH, "objname": "robot/FR"}
cfg.scene.spec_fn = lambda spec: spec.add_sensor(objtype=mujoco.mjtObj.mjOBJ_SITE, **touch)
with warnings.catch_warnings(record=True) as caught:
    env = ManagerBasedRlEnv(cfg, device="cpu")
(unfelt,) = [str(w.message) for w in caught if w.category is UnfeltWarning]
assert unfelt.endswith("(sole, sum_trunk_pos)"), unfelt
sand = sand_of(env)
env.reset()
strength = sand.strength.numpy().copy()
assert len(set(strength)) == 3 and strength.min() > 0.5 and strength.max() < 2.0
actions = torch.zeros(3, 12)
env.step(actions)
in_air = env.scene["feet_ground_contact"].data.current_air_time.clone()
for _ in range(60):
    *_, info = env.step(actions)

# The robots stand on sand alone, as their sensors of contacts with the ground say.
force = torch.tensor(sand.force.numpy()).sum(1)
weight = 9.81 * env.sim.mj_model.body_mass.sum()
assert abs(force[:, 2] / weight - 1).max() < 0.01, force
read = env.scene["feet_ground_contact"].data
assert (read.found == 1).all() and (read.current_contact_time > 1).all()
assert torch.allclose(read.force.sum(1), -force, atol=1e-3)
assert (in_air > 0).any() and (read.current_air_time == 0).all()
read = env.scene["all"].data
assert torch.allclose(read.force[:, 0], -force, atol=1e-3)
assert torch.allclose(read.dist[:, 0], -torch.tensor(sand.depth.numpy()).max(1).values)
total = env.scene["sum"].data  # in the world frame
assert torch.allclose(total.force[:, 0], -force, atol=1e-3) and (total.pos == 0).all()
assert (total.normal[:, 0, 0] == 1).all() and (total.tangent[:, 0, 1] == 1).all()
assert (env.scene["itself"].data.found == 0).all()

# A reset draws the sand of that world alone.
env.reset(env_ids=torch.tensor([1]))
assert list(sand.strength.numpy() == strength) == [True, False, True]

# Another environment of this configuration, or of a copy, has its own sand.
other = ManagerBasedRlEnv(cfg, device="cpu")
assert sand_of(env) is sand and sand_of(other) is not sand
cfg = copy.deepcopy(cfg)
cfg.sim.mujoco = MujocoCfg()
try:
    ManagerBasedRlEnv(cfg, device="cpu")
except InputError as error:
    print(error)

for task, ranges in (("Rough", {}), ("Flat", {"strength": (2.0, 1.0)})):
    try:
        on_sand(load_env_cfg(f"Mjlab-Velocity-{task}-Unitree-Go1"), **ranges)
    except InputError as error:
        print(error)
"""


def test_a_robot_of_mjlab_stands_on_sand(mjlab):
    """Its sensors of contacts read the sand, which differs between worlds."""
    paths = os.pathsep.join([str(mjlab), str(ROOT / "docs" / "models"), *sys.path])
    environment = os.environ | {"PYTHONPATH": paths, "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(
        [sys.executable, "-c", CODE], capture_output=True, text=True, env=environment, timeout=900
    )
    assert done.returncode == 0, done.stderr[-2000:]
    replaced, rough, order = done.stdout.strip().splitlines()[-3:]
    assert "use on_sand after that" in replaced
    assert "terrain_type='plane', not 'generator'" in rough
    assert "strength" in order
