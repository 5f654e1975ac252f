"""The paper's planar link, written from its equations and solved by SciPy's stiff solver.

Nothing here comes from mjgranular: y points down, x to the side towards which the link leans, q is
its angle from the vertical. `sign(v)` is replaced by `v / sqrt(v^2 + eps^2)`, so that the solver
can follow solutions that slide along `v_Ex = 0` or `v_Ey = 0`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import cos, hypot, inf, pi, sin, sqrt

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Drop:
    """A link whose end T touches the sand, and its constants; the paper's values by default."""

    speed: float = 10.0  # v_Ty(0) [m/s]
    angle: float = pi / 4  # q(0) [rad]
    tangential_speed: float = 0.0  # v_Tx(0) [m/s]
    angular_velocity: float = 0.0  # [rad/s]
    length: float = 0.2  # L [m]
    diameter: float = 0.01  # d [m]
    density: float = 7700.0  # rho_link [kg/m^3]
    sand_density: float = 2500.0  # rho_g [kg/m^3]
    eta_d: float = 6.5
    eta_h: float = 8.0
    eta_v: float = 22.0
    exponent: float = 1.1  # lambda
    gravity: float = 9.81  # [m/s^2]

    @property
    def mass(self) -> float:
        return self.density * pi * self.diameter**2 / 4 * self.length

    @property
    def inertia(self) -> float:
        return self.mass * self.length**2 / 12

    @property
    def weight(self) -> float:
        return self.mass * self.gravity

    def start(self) -> np.ndarray:
        """x_C, y_C, q and their rates, with T at the origin."""
        half, q, omega = self.length / 2, self.angle, self.angular_velocity
        return np.array(
            [
                -half * sin(q),
                -half * cos(q),
                q,
                self.tangential_speed - half * omega * cos(q),
                self.speed + half * omega * sin(q),
                omega,
            ]
        )


@dataclass(frozen=True)
class Sand:
    """The sand's force on the link, in the plane."""

    F_x: float
    F_y: float
    moment: float  # about C, in the sense of q
    depth: float  # of the lower end
    immersed: float
    x_E: float
    y_E: float
    v_Ex: float
    v_Ey: float


def exact_sign(v: float) -> float:
    return float((v > 0) - (v < 0))


def smooth_sign(v: float, eps: float = 1e-5) -> float:
    return v / sqrt(v * v + eps * eps)


def sand_force(state: np.ndarray, drop: Drop, sign: Callable[[float], float] = exact_sign) -> Sand:
    """The paper's eqs. (2), (5)-(11)."""
    x, y, q, vx, vy, omega = (float(value) for value in state)
    d, rho, g = drop.diameter, drop.sand_density, drop.gravity
    side = 1.0 if cos(q) >= 0 else -1.0  # +1: the lower end is T
    s, c = side * sin(q), side * cos(q)
    depth = y + drop.length / 2 * c
    if depth <= 0:
        return Sand(0.0, 0.0, 0.0, depth, 0.0, x + drop.length / 2 * s, depth, 0.0, 0.0)
    immersed = drop.length if depth >= drop.length * c else depth / c
    arm = drop.length / 2 - immersed / 2
    v_Ex, v_Ey = vx + omega * arm * c, vy - omega * arm * s
    speed = hypot(v_Ex, v_Ey)
    # |sin(q - q_m)| with q_m = atan2(v_Ex, v_Ey)
    lean = abs(s * v_Ey - c * v_Ex) / speed if speed > 0 else 0.0
    A_r = d * immersed * lean
    drag = drop.eta_d * rho * A_r * speed
    static_x = drop.eta_h * g * rho * depth**2 * d
    static_y = drop.eta_v * (depth / d) ** drop.exponent * g * rho * pi * d**2 / 4 * immersed
    F_x = -drag * v_Ex - sign(v_Ex) * static_x
    F_y = -drag * v_Ey - sign(v_Ey) * static_y
    moment = arm * (c * F_x - s * F_y)
    return Sand(F_x, F_y, moment, depth, immersed, x + arm * s, y + arm * c, v_Ex, v_Ey)


def distributed_force(
    state: np.ndarray, drop: Drop, sign: Callable[[float], float] = exact_sign
) -> Sand:
    """The law spread along the axis, by Gauss quadrature over the immersed part."""
    _x, y, q, vx, vy, omega = (float(value) for value in state)
    lumped = sand_force(state, drop, sign)
    if lumped.depth <= 0:
        return lumped
    d, rho, g = drop.diameter, drop.sand_density, drop.gravity
    side = 1.0 if cos(q) >= 0 else -1.0
    s, c = side * sin(q), side * cos(q)
    F_x = F_y = moment = 0.0
    for node, weight in zip(*_GAUSS, strict=True):
        arm = drop.length / 2 - lumped.immersed * (1 - node) / 2
        ds = lumped.immersed / 2 * weight
        depth = y + arm * c
        v_x, v_y = vx + omega * arm * c, vy - omega * arm * s
        drag = drop.eta_d * rho * d * abs(s * v_y - c * v_x)
        static_x = 2 * drop.eta_h * g * rho * depth * d * c
        slope = (1 + drop.exponent) * drop.eta_v * (depth / d) ** drop.exponent
        f_x = (-drag * v_x - sign(v_x) * static_x) * ds
        f_y = (-drag * v_y - sign(v_y) * slope * g * rho * pi * d**2 / 4) * ds
        F_x, F_y = F_x + f_x, F_y + f_y
        moment += arm * (c * f_x - s * f_y)
    return replace(lumped, F_x=F_x, F_y=F_y, moment=moment)


_GAUSS = [values.tolist() for values in np.polynomial.legendre.leggauss(16)]


@dataclass(frozen=True)
class Stop:
    """The state at which v_Ty is first zero; time is infinite if that was not reached."""

    time: float
    depth: float
    slides_x: float  # part of the time spent on v_Ex = 0
    slides_y: float  # part of the time spent on v_Ey = 0


@cache  # several tests compare with the same drop
def solve(
    drop: Drop,
    *,
    force: Callable[..., Sand] = sand_force,
    eps: float = 1e-5,
    rtol: float = 1e-9,
    duration: float = 2.0,
) -> Stop:
    """Follows the link until v_Ty = 0."""
    half = drop.length / 2

    def sign(v: float) -> float:
        return smooth_sign(v, eps)

    # Nothing depends on x: without it the solver's Jacobian has no empty column.
    def rates(_t: float, moving: np.ndarray) -> list[float]:
        sand = force(np.array([0.0, *moving]), drop, sign)
        return [
            moving[3],
            moving[4],
            sand.F_x / drop.mass,
            (sand.F_y + drop.weight) / drop.mass,
            sand.moment / drop.inertia,
        ]

    def tip_speed(_t: float, moving: np.ndarray) -> float:
        _y, q, _vx, vy, omega = moving
        return vy - half * omega * sin(q)

    vars(tip_speed).update(terminal=True, direction=-1.0)
    solution = solve_ivp(
        rates,
        (0.0, duration),
        drop.start()[1:],
        method="Radau",
        rtol=rtol,
        atol=1e-12,
        events=tip_speed,
    )
    assert solution.success, solution.message
    sands = [sand_force(np.array([0.0, *moving]), drop) for moving in solution.y.T]
    velocities = np.array([(sand.v_Ex, sand.v_Ey) for sand in sands])
    on_mode = np.abs(velocities) < 3 * eps
    lasting = np.diff(solution.t) @ (on_mode[1:] & on_mode[:-1])
    slides_x, slides_y = (lasting / solution.t[-1]).tolist()
    if not solution.t_events[0].size:
        return Stop(inf, float(max(sand.depth for sand in sands)), slides_x, slides_y)
    end = solution.y_events[0][0]
    depth = float(end[0] + half * cos(end[1]))
    return Stop(float(solution.t_events[0][0]), depth, slides_x, slides_y)
