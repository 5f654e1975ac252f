"""Search for the best scripted gait of an environment, on a grid over its parameters.

python scripts/search_gait.py mjgranular/ChainSwim-v0 amplitude=0.2:1 frequency=0.5:6 waves=0.5:2

Each gait runs for one episode from the same start. If the best value of a parameter is an end of
its range, widen the range.
"""

from __future__ import annotations

import argparse
import itertools
import math
from typing import Any

import numpy as np

from mjgranular.envs.gaits import gait
from mjgranular.errors import GranularError, InputError
from mjgranular.learn.evaluate import AT_ONCE, Baseline, parse_variant, run_episodes

SEED = 20_000  # evaluations use others


def main() -> None:
    """Print the five best gaits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("env", help="Gymnasium id of an environment with a scripted gait")
    parser.add_argument("ranges", nargs="+", metavar="NAME=LOW:HIGH")
    parser.add_argument("--on", default="", help="NAME=VALUE,...: arguments of the environment")
    parser.add_argument("--count", type=int, default=200, help="least number of gaits")
    parser.add_argument("--by", default="return", help="return, or a number in info")
    options = parser.parse_args()
    try:
        arguments = parse_variant(options.on)
        bounds = {}
        for name, _, ends in (text.partition("=") for text in options.ranges):
            low, colon, high = ends.partition(":")
            if not colon:
                raise InputError(f"a range is NAME=LOW:HIGH, got {name}={ends}")
            bounds[name] = float(low), float(high)
        levels = max(2, math.ceil(round(options.count ** (1 / len(bounds)), 9)))
        axes = [np.linspace(low, high, levels).tolist() for low, high in bounds.values()]
        points = [dict(zip(bounds, point, strict=True)) for point in itertools.product(*axes)]
        blocks = iter([points[first : first + AT_ONCE] for first in range(0, len(points), AT_ONCE)])

        def agent(env: Any) -> Baseline:
            task: Any = env.unwrapped.task
            scripts = [gait(task, **point) for point in next(blocks)]
            return Baseline(
                lambda steps: np.array(
                    [script(t) for script, t in zip(scripts, steps * task.dt, strict=True)]
                )
            )

        found = run_episodes(options.env, arguments, agent, [SEED] * len(points))
        values = {"return": found.returns, **found.figures}
        if options.by not in values:
            raise InputError(f"no {options.by!r}; there are: {', '.join(values)}")
    except (GranularError, ValueError) as error:
        raise SystemExit(f"error: {error}") from None
    for k in np.argsort(values[options.by])[::-1][:5]:
        words = ",".join(f"{name}={value:.3g}" for name, value in points[k].items())
        print(f"{options.by} {values[options.by][k]:.4g}: {words}")


if __name__ == "__main__":
    main()
