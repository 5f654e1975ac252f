"""A steel sphere in glass beads: speed against depth, the package beside the closed form."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import pyplot as plt
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from style import BLUE, GREEN, GREY, ORANGE, PURPLE, save

from mjgranular.experiment import Impact, run_impact

DIAMETER, MASS = 0.0254, 0.0692
DRAG_LENGTH, STIFFNESS, GRAVITY = 0.087, 1040.0, 9.81  # d1 [m], k/m [1/s^2]
DENSITY = MASS / (math.pi / 6 * DIAMETER**3)


def squared(speed: float, z: np.ndarray) -> np.ndarray:
    """v^2 at depth z after touch-down at that speed [m^2/s^2]: the closed form."""
    fall = np.exp(-2 * z / DRAG_LENGTH)
    rest = GRAVITY * DRAG_LENGTH + STIFFNESS * DRAG_LENGTH**2 / 2
    return speed**2 * fall - STIFFNESS * DRAG_LENGTH * z + rest * (1 - fall)


def stopping_time(speed: float) -> float:
    """The same motion by SciPy [s]."""

    def rate(_: float, state: np.ndarray) -> list[float]:
        z, v = state
        return [v, GRAVITY - STIFFNESS * z - v * abs(v) / DRAG_LENGTH]

    def still(t: float, state: np.ndarray) -> float:
        return float(state[1]) if t > 1e-6 else 1.0

    still.terminal, still.direction = True, -1  # type: ignore[attr-defined]
    solution = solve_ivp(
        rate, (0, 0.2), [0, speed], method="Radau", rtol=1e-11, atol=1e-13, events=still
    )
    return float(solution.t_events[0][0])


def main() -> None:
    """Draws the figure and prints the table of docs/laws/depth-velocity.md."""
    figure, axis = plt.subplots(figsize=(6.0, 3.8))
    colours = {0.0: GREY, 0.25: PURPLE, 1.0: GREEN, 2.0: BLUE, 4.0: ORANGE}
    for speed, colour in colours.items():
        result = run_impact(
            Impact(
                body="sphere", speed=speed, angle=0.0, diameter=DIAMETER, density=DENSITY,
                medium="glass_beads", law="depth_velocity",
            )
        )  # fmt: skip
        assert result.stop is not None
        depth = brentq(lambda z, v=speed: squared(v, z), 1e-6, 0.5)
        print(
            f"{speed:5} m/s  {result.stop.time:.5f} s ({stopping_time(speed):.5f}), "
            f"{result.stop.depth:.5f} m ({depth:.5f})"
        )
        z = np.linspace(0, depth, 400)
        axis.plot(1e3 * z, np.sqrt(np.clip(squared(speed, z), 0, None)), color=colour, lw=1.2)
        path = result.trajectory
        every = slice(None, None, max(1, len(path) // 16))
        label = f"{speed:g} m/s"
        axis.plot(1e3 * path.y_T[every], path.v_Ty[every], "o", ms=3.5, color=colour, label=label)
    axis.set(xlabel="depth $z$ of the lowest point [mm]", ylabel="speed [m/s]", xlim=(0, None))
    axis.set_ylim(0, None)
    axis.legend(title="at touch-down", fontsize=9)
    save(figure, "katsuragi")


if __name__ == "__main__":
    main()
