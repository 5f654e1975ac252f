"""What comes after the stop of T: the lumped law lets the link tumble, the distributed one not."""

from __future__ import annotations

import numpy as np
from matplotlib import pyplot as plt
from style import BLUE, GREY, ORANGE, save

from mjgranular.experiment import Impact, run_impact

DURATION = 0.2


def main() -> None:
    """Draws the figure and prints angles and angular velocities."""
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.4), sharex=True)
    for law, colour in (("link", ORANGE), ("link_distributed", BLUE)):
        # Not "rest" but a fixed time, for both laws alike.
        result = run_impact(Impact(law=law, until="rest", duration=DURATION))
        path, stop, rest = result.trajectory, result.stop, result.rest
        assert stop is not None
        print(f"{law}: stop {stop.time:.6f} s, {stop.depth:.6f} m, {stop.angular_velocity:.2f}")
        if rest is not None:
            print(f"  at rest from {rest.time:.4f} s, {np.degrees(rest.angle):.1f} degrees")
        for t in (0.02, 0.05, 0.1, 0.2):
            i = int(np.argmin(np.abs(path.t - t)))
            q, omega = float(np.degrees(path.q[i])), path.omega[i]
            print(f"  t = {path.t[i]:.3f} s: q = {q:.1f} degrees, omega = {omega:.1f} rad/s")
        time = np.append(path.t, DURATION)
        for axis, values in zip(axes, (np.degrees(path.q), path.omega), strict=True):
            values = np.append(values, values[-1])
            axis.plot(1e3 * time, values, color=colour, label=law)
            axis.axvline(1e3 * stop.time, color=GREY, ls=":", lw=1)
    axes[0].set(ylabel="angle from the vertical $q$ [°]", yticks=range(0, 721, 90), ylim=(0, 720))
    axes[1].set(ylabel="angular velocity $\\dot q$ [rad/s]")
    for axis in axes:
        axis.set_xlabel("time since touch-down $t$ [ms]")
    axes[1].legend(loc="upper right")
    axes[0].text(10, 690, "$T$ stops", color=GREY, fontsize=9, va="center")
    save(figure, "after_stop")


if __name__ == "__main__":
    main()
