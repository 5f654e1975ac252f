"""Chains of links: their motion in sand against Lagrange's equations.

The reference is a planar chain in absolute angles with the paper's lumped law on every link,
written from the equations and solved by SciPy's stiff solver; nothing in it comes from mjgranular.
As in the paper y points down, x to the side, and q is the angle of a link from the vertical.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mjgranular import Sand
from mjgranular.models import Link, model_path

# Constants of the paper, section 4.
LENGTH, DIAMETER, DENSITY = 0.2, 0.01, 7700.0
RHO_G, ETA_D, ETA_H, ETA_V, EXPONENT, G = 2500.0, 6.5, 8.0, 22.0, 1.1, 9.81
EPS = 1e-5  # speed over which the sign of a velocity is smoothed [m/s]


@dataclass(frozen=True)
class Lagrange:
    """n links, free (`hinge` None) or hung from a hinge at that height.

    States: for a free chain y of the upper end, the angles, velocities x and y of the upper end,
    the angles' rates; x is left out, nothing depends on it. For a pendulum the angles and rates.
    """

    n: int
    hinge: float | None = None

    @property
    def mass(self):
        return DENSITY * math.pi * DIAMETER**2 / 4 * LENGTH

    def split(self, state):
        """Depth of the upper end, its velocity, angles, their rates."""
        n = self.n
        if self.hinge is not None:
            return -self.hinge, np.zeros(2), state[:n], state[n:]
        return state[0], state[n + 1 : n + 3], state[1 : n + 1], state[n + 3 :]

    def ends(self, state):
        """Depths of the n + 1 ends, and their velocities downwards."""
        y, v, q, omega = self.split(state)
        depth = y + LENGTH * np.concatenate([[0], np.cumsum(np.cos(q))])
        return depth, v[1] - LENGTH * np.concatenate([[0], np.cumsum(omega * np.sin(q))])

    def sand(self, state):
        """Force on each link, and how far from its upper end it acts."""
        _, v, q, omega = self.split(state)
        depths, _ = self.ends(state)
        force, place = np.zeros((self.n, 2)), np.zeros(self.n)
        for k in range(self.n):
            s, c = math.sin(q[k]), math.cos(q[k])
            y_T = max(depths[k], depths[k + 1])
            if y_T > 0:
                immersed = LENGTH if y_T >= LENGTH * abs(c) else y_T / abs(c)
                place[k] = immersed / 2 if depths[k] > depths[k + 1] else LENGTH - immersed / 2
                v_E = v + place[k] * omega[k] * np.array([c, -s])
                drag = ETA_D * RHO_G * DIAMETER * immersed * abs(v_E[0] * c - v_E[1] * s)
                volume = math.pi * DIAMETER**2 / 4 * immersed
                limit = (
                    G
                    * RHO_G
                    * np.array(
                        [ETA_H * y_T**2 * DIAMETER, ETA_V * (y_T / DIAMETER) ** EXPONENT * volume]
                    )
                )
                force[k] = -drag * v_E - limit * v_E / np.sqrt(v_E**2 + EPS**2)
            v = v + LENGTH * omega[k] * np.array([c, -s])
        return force, place

    def rates(self, _t, state):
        """Lagrange's equations: M(q) a = forces - centrifugal terms."""
        n, m = self.n, self.mass
        _, v, q, omega = self.split(state)
        force, place = self.sand(state)
        across = np.stack([np.cos(q), -np.sin(q)], axis=1)  # d(unit vector)/dq of each link
        # arm[k, i]: C of link k moves by arm dq_i across link i.
        arm = LENGTH * np.tri(n, k=-1) + LENGTH / 2 * np.eye(n)
        shared = m * arm.T @ arm
        inertia = shared * np.cos(q[:, None] - q) + m * LENGTH**2 / 12 * np.eye(n)
        lever = LENGTH * np.tri(n, k=-1) + np.diag(place)
        weight = np.array([0.0, m * G])
        torque = ((lever.T @ force + arm.T @ np.tile(weight, (n, 1))) * across).sum(axis=1)
        torque -= shared * np.sin(q[:, None] - q) @ omega**2
        if self.hinge is not None:
            return np.concatenate([omega, np.linalg.solve(inertia, torque)])
        coupling = m * arm.sum(axis=0)[:, None] * across
        unit = np.stack([np.sin(q), np.cos(q)], axis=1)
        pull = force.sum(axis=0) + n * weight + m * arm.sum(axis=0) * omega**2 @ unit
        matrix = np.block([[n * m * np.eye(2), coupling.T], [coupling, inertia]])
        rates = np.linalg.solve(matrix, np.concatenate([pull, torque]))
        return np.concatenate([v[1:], omega, rates])


@dataclass(frozen=True)
class Motion:
    """Angles of the links from the vertical and their rates, depths of the ends and their speeds
    downwards; one row an instant."""

    t: np.ndarray
    angle: np.ndarray
    omega: np.ndarray
    depth: np.ndarray
    speed: np.ndarray

    def touchdown(self, end):
        return _zero(self.t, -self.depth[:, end], 0.0)

    def stop(self, end):
        """From touch-down until that end of a link no longer goes down."""
        touch = self.touchdown(end)
        return _zero(self.t, self.speed[:, end], touch) - touch

    def turn(self, link):
        """From touch-down of the chain's tip until a link first turns back."""
        touch = self.touchdown(-1)
        omega = self.omega[:, link]
        return _zero(self.t, omega * np.sign(omega[np.searchsorted(self.t, touch)]), touch) - touch


def _zero(t, value, after):
    """First time at which a positive value has come down to zero."""
    i = int(np.flatnonzero((value <= 0) & (t > after))[0])
    part = value[i - 1] / (value[i - 1] - value[i])
    return max(float(t[i - 1] + part * (t[i] - t[i - 1])), 0.0)


def lagrange(case):
    chain = Lagrange(case.n, case.hinge)
    start = np.radians(case.angles)
    if case.hinge is None:
        ends = np.concatenate([[0], np.cumsum(LENGTH * np.cos(start))])
        state = np.concatenate([[-ends.max()], start, [0, case.speed], np.zeros(case.n)])
    else:
        state = np.concatenate([start, np.zeros(case.n)])
    t = np.linspace(0, case.duration, 4001)
    solved = solve_ivp(
        chain.rates, (0, t[-1]), state, method="Radau", rtol=1e-7, atol=1e-9, t_eval=t
    )
    assert solved.success
    parts = [chain.split(row) for row in solved.y.T]
    ends = [chain.ends(row) for row in solved.y.T]
    return Motion(
        t,
        np.array([part[2] for part in parts]),
        np.array([part[3] for part in parts]),
        np.array([depth for depth, _ in ends]),
        np.array([speed for _, speed in ends]),
    )


def chain(case, timestep):
    """Rods of the paper, each with a hinge at the end of the one before."""
    link = Link()
    inertia = f"{link.inertia} {link.inertia} {link.mass * DIAMETER**2 / 8}"
    base = (
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 -1 0"/>'
    )
    if case.hinge is not None:
        base = f'<joint axis="0 -1 0" pos="0 0 {LENGTH / 2}"/>'
    links = ""
    for k in reversed(range(case.n)):
        height = -LENGTH if k else 0.0 if case.hinge is None else case.hinge - LENGTH / 2
        joint = f'<joint axis="0 -1 0" pos="0 0 {LENGTH / 2}"/>' if k else base
        links = (
            f'<body name="link{k}" pos="0 0 {height}">{joint}'
            f'<inertial pos="0 0 0" mass="{link.mass}" diaginertia="{inertia}"/>'
            f'<geom type="capsule" size="{DIAMETER / 2} {LENGTH / 2 - DIAMETER / 2}" contype="0"/>'
            f"{links}</body>"
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{timestep}"/><worldbody>{links}</worldbody></mujoco>'
    )


def posed(case):
    """Positions for the angles of a case; the lowest end of a free chain touches the sand."""
    angle = np.radians(case.angles)
    bends = np.diff(angle)
    if case.hinge is not None:
        return np.array([angle[0], *bends])
    ends = LENGTH * np.concatenate([[0], np.cumsum(-np.cos(angle))])
    return np.array([0.0, ends[:2].mean() - ends.min(), angle[0], *bends])


def simulate(case, timestep=1e-5):
    free = case.hinge is None
    model = chain(case, timestep)
    sand, data = Sand(model, law="link", scheme="explicit"), mujoco.MjData(model)
    data.qpos[:] = posed(case)
    if free:
        data.qvel[1] = -case.speed
    steps = round(case.duration / timestep)
    states = np.zeros((steps + 1, 2, model.nq))
    for state in states[:-1]:
        state[:] = data.qpos, data.qvel
        sand.step(data)
    states[-1] = data.qpos, data.qvel
    base = 2 if free else 0
    angle, omega = np.cumsum(states[:, :, base:], axis=2).transpose(1, 0, 2)
    if free:
        upper = -states[:, 0, 1] - LENGTH / 2 * np.cos(angle[:, 0])
        falling = -states[:, 1, 1] + LENGTH / 2 * np.sin(angle[:, 0]) * omega[:, 0]
    else:
        upper, falling = np.full(steps + 1, -case.hinge), np.zeros(steps + 1)
    zero = np.zeros((steps + 1, 1))
    depth = upper[:, None] + LENGTH * np.hstack([zero, np.cumsum(np.cos(angle), axis=1)])
    speed = falling[:, None] - LENGTH * np.hstack([zero, np.cumsum(omega * np.sin(angle), axis=1)])
    return Motion(np.arange(steps + 1) * timestep, angle, omega, depth, speed)


@dataclass(frozen=True)
class Case:
    n: int
    hinge: float | None
    angles: tuple[float, ...]  # from the vertical [deg]
    speed: float
    duration: float


PENDULUMS = {
    "swings in": Case(2, 0.36, (45, 45), 0.0, 0.5),
    "bent, deep": Case(2, 0.3, (70, 20), 0.0, 0.5),
}
DROPS = {
    "3 links": Case(3, None, (30, -20, 45), 2.0, 0.09),
    "3 straight": Case(3, None, (45, 45, 45), 2.0, 0.09),
    "5 links": Case(5, None, (30, -20, 45, 10, -40), 2.0, 0.09),
}


def compare(case):
    solved, found = lagrange(case), simulate(case)
    angle = np.stack([np.interp(solved.t, found.t, column) for column in found.angle.T], axis=1)
    travel = np.abs(solved.angle - solved.angle[0]).max()
    # 0.5 % is asked for; measured 6e-5.
    assert np.abs(angle - solved.angle).max() < 5e-4 * travel
    return solved, found


@pytest.mark.parametrize("name", PENDULUMS)
def test_double_pendulum_follows_lagranges_equations(name):
    solved, found = compare(PENDULUMS[name])
    assert solved.depth[:, -1].max() > DIAMETER / 2  # it does plough
    # 0.5 % is asked for; measured 1.3e-4.
    assert found.stop(-1) == pytest.approx(solved.stop(-1), rel=5e-4)
    assert found.turn(0) == pytest.approx(solved.turn(0), rel=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", DROPS)
def test_dropped_chain_follows_lagranges_equations(name):
    solved, found = compare(DROPS[name])
    assert solved.depth[-1, -2] > DIAMETER / 2  # the next link is in the sand too
    assert found.stop(-1) == pytest.approx(solved.stop(-1), rel=5e-4)


def at_start(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(
    ("name", "count", "length"), [("double_pendulum", 2, 0.2), ("chain7", 7, 0.1)]
)
def test_links_of_the_files_are_slender_rods_that_meet_at_the_joints(name, count, length):
    model = mujoco.MjModel.from_xml_path(str(model_path(name)))
    data, link = at_start(model), Link(length)
    assert model.nbody == count + 1
    for i in range(count):
        body, geom = model.body(f"link{i}"), model.geom(f"link{i}")
        along = link.mass * DIAMETER**2 / 8
        assert body.mass[0] == pytest.approx(link.mass, rel=1e-12)
        assert body.inertia == pytest.approx([link.inertia, link.inertia, along], rel=1e-12)
        assert (body.ipos == 0).all()
        assert 2 * (geom.size[0] + geom.size[1]) == pytest.approx(length, rel=1e-12)
        if i:
            joint, end = model.joint(f"q{i}").id, data.site(f"T{i - 1}").xpos
            assert data.xanchor[joint] == pytest.approx(end, abs=1e-12)
    assert data.ncon == 0  # links do not touch one another
    elements = Sand(model, law="link", scheme="explicit").elements
    assert [model.geom(e["geom"]).name for e in elements] == [f"link{i}" for i in range(count)]


def test_the_double_pendulum_swings_into_the_sand():
    model = mujoco.MjModel.from_xml_path(str(model_path("double_pendulum")))
    data, sand = at_start(model), Sand(model, law="link", scheme="explicit")
    start = sand.report(data)["link1"].depth
    for _ in range(30000):
        sand.step(data)
    assert start < 0 < sand.report(data)["link1"].depth < 0.04
