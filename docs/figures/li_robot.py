"""Speeds of the robot of Li, Zhang and Goldman on loose poppy seed, measured and simulated."""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from style import save

from mjgranular import Sand
from mjgranular.models import LiRobot

MEASURED = Path(__file__).parents[2] / "referee" / "data" / "robot"
WARM, MEAN = 2.0, 3.0  # the least time before it is steady, and that of the mean [s]


def speed(robot: LiRobot, sand: Sand, frequency: float) -> float:
    """Return the mean speed over whole turns of the legs, once it is steady [m/s]."""
    step = sand.model.opt.timestep
    turn = 1 / frequency
    data = mujoco.MjData(sand.model)
    data.qpos, data.qvel, data.ctrl = robot.start(frequency)
    warm, mean = (np.ceil(time / turn) * turn for time in (WARM, MEAN))
    while data.time < warm - step / 2:
        sand.step(data)
    before, since = data.qpos[0], data.time
    while data.time < since + mean - step / 2:
        sand.step(data)
    return float(data.qpos[0] - before) / (data.time - since)


def main() -> None:
    """Draw the figure and print the speeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--law", help="name of the law; that of the medium without")
    law = parser.parse_args().law
    legs = [float(file.stem.removeprefix("curvature_")) for file in MEASURED.glob("*.csv")]
    figure, axis = plt.subplots(figsize=(6.0, 3.8))
    errors = []
    colors = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(legs)))
    for color, curvature in zip(colors, sorted(legs), strict=True):
        robot = LiRobot(curvature)
        sand = Sand(robot.model(), medium="poppy_seed_loose", law=law, instead_of="floor")
        rows = np.loadtxt(MEASURED / f"curvature_{curvature:g}.csv", delimiter=",", skiprows=1)
        frequency, measured, deviation = rows.T
        simulated = np.array([speed(robot, sand, f) for f in frequency])
        for f, there, here in zip(frequency, measured, simulated, strict=True):
            print(f"{curvature:5} {f:6.3f} Hz  {there:.3f} {here:.3f} m/s  {here / there - 1:+.0%}")
        errors.extend(simulated / measured - 1)
        axis.errorbar(frequency, measured, deviation, fmt="o", ms=4, color=color, capsize=2)
        axis.plot(frequency, simulated, color=color, label=f"$R/r = {curvature:g}$")
    print(f"mean error {np.abs(errors).mean():.1%}, bias {np.mean(errors):+.1%}")
    axis.set(xlabel="turns of the legs per second [Hz]", ylabel="speed [m/s]")
    axis.set(xlim=(0, None), ylim=(0, None))
    axis.legend(title="points measured, lines simulated", fontsize=9, title_fontsize=9)
    save(figure, "li_robot")


if __name__ == "__main__":
    main()
