"""Score a law against what moves sideways: legs that turn, drawn bodies, a robot, a wheel.

    python referee/sideways.py [--law SPEC]

A short way to the part of `validate.py` that a law for thrust, drag and wheels is judged by.
Nothing is fitted but the strength of drawn bodies, which comes from a push in the same bed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.calibrate import RunSet, compare, read_runs, simulate
from mjgranular.law import Law, get_law

DATA = Path(__file__).parent / "data"
SMALL = 0.25  # of the load: reference for smaller horizontal forces on wheels; chosen


def score(law: str | Law = "rft3d_dynamic") -> dict[str, Any]:
    """Return all scores of a law, relative: `legs`, `drawn`, `wheel`, `robot` and `summary`."""
    legs = {
        f"{name[5:]} {run.name}": compare(run.motion, simulate(run, runs.medium, law)).trajectory
        for name in ("legs_poppy", "legs_glass")
        for runs in [read_runs(DATA / name)]
        for run in runs.runs
    }
    drawn = {}
    for name in ("drawn", "drawn_rough"):
        runs = read_runs(DATA / name)
        fitted = fit_scale(runs, law)
        for run in runs.runs[1:]:
            drawn |= {
                f"{name} {run.name} {row[0]:g} m/s": (row[2] / row[1], row[4] / row[3])
                for row in _columns(run.motion, simulate(run, runs.medium, fitted))
            }
    wheel, robot = _wheel(law), {}
    runs = read_runs(DATA / "robot")
    for run in runs.runs:
        speeds = simulate(run, runs.medium, law).speed
        rows = zip(run.motion.rate, run.motion.speed, speeds, strict=True)  # pyright: ignore
        robot |= {f"{run.name} {rate:g} Hz": (v, found) for rate, v, found in rows}
    errors = [found / v - 1 for v, found in robot.values()]
    pulls = [abs(pull - 1) for pull, _ in drawn.values()]
    summary = {
        "legs": _mean(legs.values()),
        "drawn": _mean(pulls),
        "drawn, worst": max(pulls),
        "robot": _mean(map(abs, errors)),
        "robot, bias": _mean(errors),
        "wheel, |ln| of lift": _mean(abs(np.log(case["lift"])) for case in wheel.values()),
        "wheel, horizontal": _mean(case["error"] for case in wheel.values()),
        "wheel free, force": _mean(case["free error"] for case in wheel.values()),
        "wheel free, sinkage": _mean(abs(case["free depth"] - 1) for case in wheel.values()),
    }
    return {"legs": legs, "drawn": drawn, "wheel": wheel, "robot": robot, "summary": summary}


def fit_scale(runs: RunSet, law: str | Law) -> Law:
    """Return the law with its `scale` fitted by least squares to the first run, a push."""
    push, made = runs.runs[0], get_law(law, runs.medium)
    found = simulate(push, runs.medium, made).force
    measured = push.motion.force
    assert found is not None
    assert measured is not None
    factor = float((measured * found).sum() / (found * found).sum())
    return replace(made, scale=factor * made.scale)  # pyright: ignore


def _columns(measured: Any, found: Any) -> Iterable[tuple[float, ...]]:
    columns = (measured.speed, measured.force, found.force, measured.lift, found.lift)
    return zip(*columns, strict=True)


def _wheel(law: str | Law) -> dict[str, dict[str, float]]:
    """Return law over measurement, at the measured sinkage and free, by slip and slip angle."""
    runs = read_runs(DATA / "wheel")
    out: dict[str, dict[str, float]] = {}
    for given, free in zip(runs.runs[::2], runs.runs[1::2], strict=True):
        motion: Any = given.motion
        led: Any = simulate(given, runs.medium, law)
        sunk: Any = simulate(free, runs.medium, law)
        measured = np.array([motion.force, motion.side])
        size = np.linalg.norm(measured, axis=0)
        base = np.maximum(size, SMALL * motion.lift)

        pairs = np.array([[each.force, each.side] for each in (led, sunk)])
        force, free_force = np.linalg.norm(pairs, axis=1) / size
        error, free_error = np.linalg.norm(pairs - measured, axis=1) / base
        for i, (spin, angle) in enumerate(zip(motion.spin, motion.angle, strict=True)):
            out[f"{angle:.0f} deg, {spin:.3f} rad/s"] = {
                "measured": float(size[i]),
                "lift": float(led.lift[i] / motion.lift[i]),
                "force": float(force[i]),
                "error": float(error[i]),
                "free force": float(free_force[i]),
                "free error": float(free_error[i]),
                "free depth": float(sunk.depth[i] / motion.depth[i]),
            }
    return out


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def main() -> None:
    """Print all scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--law", default="rft3d_dynamic", help="with its constants, as for Sand")
    found = score(parser.parse_args().law)
    print("legs: rms of the force over the greatest")
    for name, value in found["legs"].items():
        print(f"  {name:40} {value:6.1%}")
    print("\ndrawn through grains: law over grains, resistance and lift")
    for name, (pull, lift) in found["drawn"].items():
        print(f"  {name:40} {pull:6.2f} {lift:6.2f}")
    print("\nwheel: law over measured, at the measured sinkage and free to sink under its load")
    keys = list(next(iter(found["wheel"].values())))
    print(f"  {'':24}" + "".join(f"{key:>11}" for key in keys))
    for name, case in found["wheel"].items():
        print(f"  {name:24}" + "".join(f"{case[key]:11.2f}" for key in keys))
    print("\nrobot: measured and simulated speed [cm/s]")
    for name, (measured, simulated) in found["robot"].items():
        error = simulated / measured - 1
        print(f"  {name:24} {100 * measured:6.1f} {100 * simulated:6.1f} {error:+7.1%}")
    print()
    for name, value in found["summary"].items():
        print(f"{name:24} {value:7.1%}")


if __name__ == "__main__":
    main()
