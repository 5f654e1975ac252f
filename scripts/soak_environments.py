"""Random actions for a million steps, on sand drawn anew: nothing is to become bad.

    python scripts/soak_environments.py                     # every environment, 1e6 steps each
    python scripts/soak_environments.py ChainSwim Hexapod --steps 20000

Counts MuJoCo's warnings and what is not finite. Takes hours for all of them on two cores.
"""

from __future__ import annotations

import argparse
import sys
import time

import mujoco
import numpy as np

from mjgranular.envs import SandRanges, SandVectorEnv, tasks

RANGES = SandRanges(strength=(0.5, 2.0), density=(0.5, 2.0), slope=(-0.15, 0.15))
NUM_ENVS = 64


def soak(name: str, steps: int) -> bool:
    """Run one environment; print the result and return whether all was well."""
    batch = SandVectorEnv(name, NUM_ENVS, max_episode_steps=tasks[name].episode, randomise=RANGES)
    batch.reset(seed=0)
    batch.action_space.seed(0)
    started, bad, fastest = time.perf_counter(), 0, 0.0
    kinds = [kind for name, kind in mujoco.mjtWarning.__members__.items() if name != "mjNWARNING"]
    told: dict[str, int] = {}
    rounds = -(-steps // NUM_ENVS)
    for _ in range(rounds):
        observations, rewards, *_ = batch.step(batch.action_space.sample())
        bad += not (np.isfinite(observations).all() and np.isfinite(rewards).all())
        fastest = max(fastest, float(np.abs(batch.batch.bind("qvel")).max()))
        numbers = batch.batch.warning[:, :, 1].sum(axis=0)  # a reset clears them
        for kind, number in zip(kinds, numbers, strict=True):
            if number:
                told[kind.name.removeprefix("mjWARN_")] = int(number)
    seconds = time.perf_counter() - started
    print(
        f"{name}: {rounds * NUM_ENVS} steps in {seconds:.0f} s, {bad} not finite, "
        f"warnings {told or 'none'}, fastest {fastest:.3g}",
        flush=True,
    )
    return not bad and not told


def main() -> int:
    """Run the given environments, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(tasks))
    parser.add_argument("--steps", type=int, default=1_000_000)
    options = parser.parse_args()
    results = [soak(name, options.steps) for name in options.names]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
