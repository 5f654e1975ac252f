"""The lumped link law solved without mjgranular: SciPy's Radau method, from the paper's equations.

The paper's coordinates: x to the side, y down, q the angle from the vertical.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

L, D, RHO = 0.2, 0.01, 7700.0  # link
RHO_G, ETA_D, ETA_H, ETA_V, LAMBDA = 2500.0, 6.5, 8.0, 22.0, 1.1  # sand
G = 9.81
M = RHO * math.pi * D**2 / 4 * L
I = M * L**2 / 12  # noqa: E741


def sign(v: float, eps: float) -> float:
    """Sign of v; with eps > 0 a smooth one, for motions that slide along v = 0."""
    return v / math.sqrt(v * v + eps * eps) if eps else float(np.sign(v))


def rates(t: float, state: np.ndarray, eps: float) -> list[float]:
    """Time derivative of (x_C, y_C, q, v_x, v_y, omega)."""
    _, y, q, vx, vy, omega = state
    s, c = math.sin(q), math.cos(q)
    y_T = y + L / 2 * c
    if y_T <= 0:
        return [vx, vy, omega, 0.0, G, 0.0]
    length = min(y_T / c, L)
    arm = (L - length) / 2  # eq. (5)
    v_Ex, v_Ey = vx + omega * arm * c, vy - omega * arm * s  # eq. (6)
    drag = ETA_D * RHO_G * D * length * abs(v_Ex * c - v_Ey * s)  # eqs. (2), (7)
    F_x = -drag * v_Ex - sign(v_Ex, eps) * ETA_H * G * RHO_G * y_T**2 * D  # eq. (10)
    volume = math.pi * D**2 / 4 * length  # eq. (9)
    F_y = -drag * v_Ey - sign(v_Ey, eps) * ETA_V * (y_T / D) ** LAMBDA * G * RHO_G * volume
    return [vx, vy, omega, F_x / M, G + F_y / M, arm * (c * F_x - s * F_y) / I]


def stop(speed: float, angle: float, eps: float = 0.0) -> tuple[float, float]:
    """Stopping time [s] and depth y_T [m] of a drop with T on the surface.

    Args:
        speed: v_Ty(0) [m/s].
        angle: q(0) [rad].
        eps: speed over which the sign of a velocity is smoothed [m/s].
    """

    def tip_speed(t: float, state: np.ndarray, eps: float) -> float:
        return state[4] - state[5] * L / 2 * math.sin(state[2])

    tip_speed.terminal = True
    tip_speed.direction = -1
    start = [-L / 2 * math.sin(angle), -L / 2 * math.cos(angle), angle, 0.0, speed, 0.0]
    solution = solve_ivp(
        rates,
        (0.0, 1.0),
        start,
        method="Radau",
        rtol=1e-12,
        atol=1e-14,
        max_step=1e-4,
        events=tip_speed,
        args=(eps,),
    )
    state = solution.y_events[0][0]
    return float(solution.t_events[0][0]), float(state[1] + L / 2 * math.cos(state[2]))


if __name__ == "__main__":
    for speed, degrees in ((10, 45), (5, 45), (1, 45), (2, 60), (2, 45), (2, 30)):
        time, depth = stop(speed, math.radians(degrees))
        print(f"{speed:2d} m/s {degrees} deg: {time:.9f} s {depth:.9f} m")
