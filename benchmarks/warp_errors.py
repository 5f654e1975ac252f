"""Errors of a step in MuJoCo Warp: velocities against those of the CPU's implicit scheme.

    python benchmarks/warp_errors.py
    python benchmarks/warp_errors.py --names Hopper --states 500 --deepest 0.1

Each state is a random pose, with its lowest point up to `deepest` under the surface, and random
velocities of 0.03, 0.3 or 1 m/s and rad/s; there is no step before it. An error is the size of the
difference of all joint velocities after a step of 2 ms over that of their change.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import tyro
import warp as wp

from mjgranular import GranularWarning, Sand
from mjgranular.envs import tasks
from mjgranular.envs.ground import place, quiet
from mjgranular.warp import WarpSand, coupled

BOX = """<mujoco><worldbody><body name="box"><freejoint/>
  <geom type="box" size="0.1 0.08 0.05" mass="2"/></body></worldbody></mujoco>"""
CORRECTIONS = (1, 3, 10)


@dataclass(frozen=True)
class Options:
    """Errors of a step in MuJoCo Warp."""

    names: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ("Hopper", "box", "Ant")
    """Environments, or `box`."""
    states: int = 150
    """Random states."""
    deepest: float = 0.05
    """Greatest depth of the lowest point [m]."""
    device: str = "cpu"
    """Of Warp's."""


def prepared(name: str) -> tuple[mujoco.MjModel, Any]:
    """Return a model and the sand under it."""
    if name == "box":
        spec, given = mujoco.MjSpec.from_string(BOX), None
    else:
        task = tasks[name]()
        spec = task.scene()
        (given,) = place(spec, task.sands)
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_DISCRETE, 0.002
    return coupled(spec).compile(), given


def states(model: mujoco.MjModel, sand: Sand, options: Options) -> tuple[np.ndarray, np.ndarray]:
    """Return random positions and velocities."""
    random, data = np.random.default_rng(0), mujoco.MjData(model)
    qpos = np.tile(model.qpos0, (options.states, 1))
    qvel = random.normal(size=(options.states, model.nv))
    qvel *= random.choice([0.03, 0.3, 1.0], (options.states, 1))
    for row in qpos:
        mujoco.mj_integratePos(model, row, 0.3 * random.normal(size=model.nv), 1.0)
        data.qpos, data.qvel = row, 0.0
        depth = max(body.depth for body in sand.report(data).bodies)
        upward = 2 if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else model.joint("rootz").id
        row[upward] += depth - random.uniform(0, options.deepest)
    return qpos, qvel


def errors(name: str, options: Options) -> dict[int, np.ndarray]:
    """Return the error of each state, by the number of corrections."""
    model, given = prepared(name)
    sand, data = Sand(model, given, scheme="implicit"), mujoco.MjData(model)
    qpos, qvel = states(model, sand, options)
    right, found = np.empty_like(qvel), {}
    for world in range(options.states):
        data.qpos, data.qvel, data.qacc_warmstart = qpos[world], qvel[world], 0.0
        sand.step(data)
        right[world] = data.qvel
    for corrections in CORRECTIONS:
        put = WarpSand(model, given, corrections=corrections)
        with wp.ScopedDevice(options.device):
            m = mjw.put_model(model)
            d = mjw.put_data(model, mujoco.MjData(model), nworld=options.states)
            put.attach(m, d)
            d.qpos.assign(qpos.astype(np.float32))
            d.qvel.assign(qvel.astype(np.float32))
            d.qacc_warmstart.zero_()
            mjw.step(m, d)
        wrong = np.linalg.norm(d.qvel.numpy() - right, axis=1)
        found[corrections] = wrong / np.linalg.norm(right - qvel, axis=1)
    return found


def main() -> None:
    """Print medians and 90 % quantiles."""
    options = tyro.cli(Options, description=(__doc__ or "").splitlines()[0])
    wp.config.log_level = wp.LOG_ERROR
    for name in options.names:
        with quiet(), warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)
            found = errors(name, options)
        for corrections, error in found.items():
            print(
                f"{name}, {corrections} corrections: median {np.median(error):.0e}, "
                f"90 % {np.quantile(error, 0.9):.0e}"
            )


if __name__ == "__main__":
    main()
