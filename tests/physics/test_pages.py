"""The default law as docs/laws/rft.md and docs/scheme.md state it, in plain NumPy, for bodies.

Nothing of the law comes from the package: only the facets of a body, their faces and the medium.
"""

import math
import re
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

from mjgranular import Memory, Sand
from mjgranular.shape import rigid
from mjgranular.shape.tessellation import CORNERS

# f1, f2, f3 of Agarwal, Goldman and Kamrin (2023), by 1, x1, x2, x3, x1^2, x2^2, x3^2, x1 x2,
# x2 x3, x3 x1, x1^3, x2^3, x3^3, x1 x2^2, x2 x1^2, x2 x3^2, x3 x2^2, x3 x1^2, x1 x3^2, x1 x2 x3.
FIT = np.array([
    [0.00212, -0.06796, -0.02634], [-0.02320, -0.10941, -0.03436], [-0.20890, 0.04725, 0.45256],
    [-0.43083, -0.06914, 0.00835], [-0.00259, -0.05835, 0.02553], [0.48872, -0.65880, -1.31290],
    [-0.00415, -0.11985, -0.05532], [0.07204, -0.25739, 0.06790], [-0.02750, -0.26834, -0.16404],
    [-0.08772, 0.02692, 0.02287], [0.01992, -0.00736, 0.02927], [-0.45961, 0.63758, 0.95406],
    [0.40799, 0.08997, -0.00131], [-0.10107, 0.21069, -0.11028], [-0.06576, 0.04748, 0.01487],
    [0.05664, 0.20406, -0.02730], [-0.09269, 0.18519, 0.10911], [0.01892, 0.04934, -0.04097],
    [0.01033, 0.13527, 0.07881], [0.15120, -0.33207, -0.27519],
])  # fmt: skip
G, UP, RAMP, KAPPA, LAMBDA, SLIP = 9.81, np.array([0.0, 0.0, 1.0]), 0.05, 2.5, 1.1, 2.0
DOCS = Path(__file__).resolve().parents[2] / "docs"


def part(d, a, b):
    """Where d + a s + b t > 0 on a facet: share, centroid, mean over all, center of pressure."""
    square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
    corners = [np.array([s, t, d + a * s + b * t]) for s, t in square]
    kept = []
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        if here[2] > 0:
            kept.append(here)
        if (here[2] > 0) != (there[2] > 0):
            kept.append(here + here[2] / (here[2] - there[2]) * (there - here))
    area, first, mean, moment = 0.0, np.zeros(2), 0.0, np.zeros(2)
    for second, third in pairwise(kept[1:]):
        p, z = np.array([kept[0], second, third])[:, :2], np.array([kept[0], second, third])[:, 2]
        piece = abs(np.linalg.det(p[1:] - p[0])) / 2
        area, first, mean = area + piece, first + piece * p.mean(axis=0), mean + piece * z.mean()
        moment += piece / 12 * (p.sum(axis=0) * z.sum() + z @ p)
    if area == 0:
        return 0.0, first, 0.0, first
    return area / 4, first / area, mean / 4, moment / mean if mean > 0 else 0 * first


class Page:
    """The constants of a medium."""

    def __init__(self, law):
        mu, phi = law.internal_friction, math.atan(law.internal_friction)
        self.mu, self.slip, self.rho, self.grain = mu, law.surface_friction, law.density, law.grain
        self.c = math.tan(math.pi / 4 + phi / 2) / 6
        strength = (1 - math.sin(phi)) * math.exp(-(math.pi / 2 - phi) * mu)  # (S1)
        self.lateral = (1 + self.c) * strength / 0.219
        self.xi = law.scale * law.density * G * self.cubic(mu)

    @staticmethod
    def cubic(mu):
        return 894 * mu**3 - 386 * mu**2 + 89 * mu

    def stress(self, n, u):
        m = n if n @ UP <= 1e-6 else -n
        x, y, z = -u @ UP, -m @ UP, m @ u
        f = FIT.T @ [
            1, x, y, z, x**2, y**2, z**2, x * y, y * z, z * x, x**3, y**3, z**3, x * y**2,
            y * x**2, y * z**2, z * y**2, z * x**2, x * z**2, x * y * z,
        ]  # fmt: skip
        a = f[0] * m + f[1] * u - f[2] * UP
        across = a - (a @ n) * n
        normal = abs(a @ n)
        across *= min(self.slip * normal / np.linalg.norm(across), 1)
        if across @ u > normal * (n @ u):
            across *= max(normal * (n @ u), 0) / (across @ u)
        q, s = max(n @ u, 0) ** 8, (1 - u[2] ** 2) * (1 - n[2] ** 2)
        big = 1 + (self.lateral * (1 + q) / 2 - 1) * s  # (S2)
        low, high = min(self.lateral / 2 - 1, 0), min(self.lateral - 1, 0)
        small = 1 + (low * (1 - q) + high * q) * s  # (S3)
        k = 1 - 0.3 * 4 * n[2] ** 2 * (1 - n[2] ** 2) * (1 - (1 - u[2] ** 2) ** 2)  # (S4)
        j = 1 + n[2] ** 2 * (1 - (n @ u) ** 2) ** 8 * (1 - (1 - u[2] ** 2) ** 8)  # (S5)
        return k * j * (small * across - big * normal * n)


class Facet:
    """A facet at the start of a step."""

    def __init__(self, page, element, turn, place, velocity, spin, h):
        self.page, self.n = page, turn @ element["normal"]
        self.spread, edges = element["spread"] @ turn.T, element["edges"] @ turn.T
        middle = place + turn @ element["point"]
        self.depth, self.rises = -middle @ UP, -edges @ UP
        share, _, self.mean, pressure = part(self.depth, *self.rises)
        self.arm = middle + pressure @ edges - place
        self.v = velocity + np.cross(spin, self.arm)
        self.area, width = element["area"], element["face"]
        self.slide(edges, spin, element, pressure)
        self.push = LAMBDA * page.rho * self.area * share
        if self.mean == 0:
            return
        facing = max(-self.n @ UP, 0) * element["flat"]
        self.cone = page.c * facing * width / max(self.mean, width / 10)
        pressure = page.xi * self.mean * (1 + self.cone)
        number = np.linalg.norm(self.v) / width * page.grain * math.sqrt(page.rho / 0.59 / pressure)
        fast = page.mu + 0.26 * number / (number + 0.279)
        self.strength = page.xi * page.cubic(fast) / page.cubic(page.mu)
        # (A1)
        layer = min(KAPPA * element["layer"], self.mean / max(self.n @ UP, 1e-300))
        whole = page.rho * self.area * layer
        reach = abs(self.rises).sum()
        deep, height = self.depth + reach, 2 * reach + width / 8
        self.mass = whole * min(deep / height, 1)
        self.before = whole * min(max(min(deep, deep + h * self.v @ UP), 0) / height, 1)
        self.speed = max(self.n @ self.v, 0)
        # n and the arm turn together, so only the body's velocity turns against n.
        self.had = max(self.n @ self.v - h * np.cross(spin, self.n) @ velocity, 0)

    def slide(self, edges, spin, element, pressure):
        """(S6) to (S8): h, q, e, and the share b of the traction that opposes the motion."""
        turn, speed, lead = np.cross(spin, self.n), np.linalg.norm(self.v), self.n @ self.v
        dual, slow = np.linalg.pinv(edges), 1e-6 * G * element["face"]
        bend = dual @ self.spread @ dual @ edges
        curvatures, axes = np.linalg.eigh((bend + bend.T) / 2)
        part = np.clip(10 * np.abs(curvatures) * element["face"] - 4, 0, 1) ** 3
        axes, part, curvatures = axes[:, part > 0], part[part > 0], curvatures[part > 0]
        h = (1 - element["flat"]) * axes @ (part * (axes.T @ turn) / curvatures)
        turn = self.spread.T @ dual.T @ h
        across, self.turns = self.v - lead * self.n, self.spread @ h
        h -= (h @ self.n) * self.n
        self.turn = pressure @ self.turns
        lead += self.turn
        bulge = np.einsum("ij,ij", edges, self.spread) / 6
        self.turns -= bulge * self.spread @ turn
        most, q = SLIP * max(lead, RAMP * speed), 0.0
        if across @ across > most**2 and h @ across > 0:
            rest = (h @ across) ** 2 - h @ h * (across @ across - most**2)
            q = min((h @ across - math.sqrt(max(rest, 0))) / (h @ h), 1)
        self.slides, gone = math.sqrt(across @ across + slow), q * np.linalg.norm(h)
        self.e, self.d = across / self.slides, q * h / self.slides
        self.rubs = min(2 * gone / (gone + self.slides), 1)
        scale = math.sqrt(speed**2 + slow)
        self.turn, self.turns, self.slides = (
            x / scale for x in (self.turn, self.turns, self.slides * (h @ h > 0))
        )

    def static(self, u):
        rises = self.spread @ u - self.turns
        c, (a, b), moves = self.n @ u + self.turn, rises, 1.0
        if abs(a) + abs(b) < RAMP:
            first = RAMP - abs(b)
            moves, a = abs(a) / first, math.copysign(first, a)
        share, (s, t), _, _ = part(c, a, b)
        if share == 0:
            return 0 * u
        s *= moves
        load = (
            share
            * part(self.depth + self.rises @ [s, t], *(self.rises * (1 - abs(s), 1 - abs(t))))[2]
        )
        n = self.n + s * self.spread[0] + t * self.spread[1]
        leads = (c + rises @ [s, t]) / np.linalg.norm(n)
        n, w = n / np.linalg.norm(n), u
        if self.slides > 0:
            e, d = (x - (x @ n) * n for x in (self.e, self.d))
            w = u - (e @ u) * d + (leads - n @ u) * n  # (S7)
            w /= np.linalg.norm(w)
        stress = self.page.stress(n, w)
        stress -= max(stress @ w, 0) * w
        if self.slides > 0:  # (S8)
            traction, along, share = stress - (stress @ n) * n, u - (u @ n) * n, self.rubs
            against = -np.linalg.norm(traction) * along / max(np.linalg.norm(along), self.slides)
            if stress @ u > 0:
                share = max(share, min(stress @ u / ((traction - against) @ u), 1))
            stress = stress + share * (against - traction)
            stress -= max(stress @ u, 0) * u
        return self.strength * self.area * load * (1 + self.cone * w[2] ** 2) * stress

    def force(self, v, part_kept, h):
        """The force at the velocity at the end of the step (A2, A3, A5)."""
        s = max(self.n @ v, 0)
        f = self.static(v / np.linalg.norm(v)) - self.push * s**2 * self.n
        a = (self.before * self.speed * part_kept - self.mass * s) / h
        most = min(-self.n @ f, -f @ v / s if s > 0 else math.inf)
        return f + min(a, max(most, 0)) * self.n


def facets_of(page, elements, turn, place, velocity, spin, h):
    """Those in the sand, and by how much the body's sand slows down (A4)."""
    facets = [Facet(page, element, turn, place, velocity, spin, h) for element in elements]
    facets = [facet for facet in facets if facet.mean > 0]
    had = sum(facet.before * facet.had**2 for facet in facets)
    has = sum(facet.before * facet.speed**2 for facet in facets)
    return facets, min(1, math.sqrt(had / has)) if has > 0 else 1


HEAVY = """
<mujoco>
  <option timestep="1e-3"/>
  <worldbody>
    <body name="body" gravcomp="1">
      <freejoint/><inertial pos="0 0 0" mass="1e8" diaginertia="1e8 1e8 1e8"/>{geoms}
    </body>
  </worldbody>
</mujoco>
"""
BODIES = {
    "box": '<geom type="box" size="0.03 0.02 0.01"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.03 0.02 0.01"/>',
    "cylinder": '<geom type="cylinder" size="0.03 0.02"/>',
    "capsule": '<geom type="capsule" size="0.01 0.04"/>',
    "boot": '<geom type="box" size="0.03 0.02 0.01"/>'
    '<geom type="cylinder" size="0.01 0.03" pos="0.01 0.01 0.03"/>',
}


@pytest.mark.parametrize("geoms", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("medium", ["quikrete_medium", "poppy_seed_loose"])
def test_the_pages_give_the_forces_of_the_default_law(geoms, medium):
    # So heavy a body has the same velocity at the end of a step.
    model = mujoco.MjModel.from_xml_string(HEAVY.format(geoms=geoms))
    data, sand = mujoco.MjData(model), Sand(model, medium=medium)
    page, h, rng = Page(sand.law), model.opt.timestep, np.random.default_rng(1)
    compared = 0
    for k in range(9):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.linalg.det(turn)
        place = np.append(rng.normal(size=2), rng.uniform(-0.05, 0.02))
        velocity = rng.normal(size=3) * 10 ** rng.uniform(-1.5, 0.5)
        spin = rng.normal(size=3) * 10 ** rng.uniform(-1, 1) * (k % 3 > 0)
        mujoco.mj_resetData(model, data)
        data.qpos[:3], data.qvel[:3], data.qvel[3:] = place, velocity, turn.T @ spin
        mujoco.mju_mat2Quat(data.qpos[3:], turn.ravel())
        mujoco.mj_forward(model, data)
        report = sand.report(data)["body"]
        facets, kept = facets_of(page, sand.elements, turn, place, velocity, spin, h)
        forces = [facet.force(facet.v, kept, h) for facet in facets]
        compared += len(forces) > 0
        force = np.sum(forces, axis=0) if forces else np.zeros(3)
        moments = [np.cross(facet.arm, f) for facet, f in zip(facets, forces, strict=True)]
        moment = np.sum(moments, axis=0) if forces else np.zeros(3)
        size = sum(np.linalg.norm(f) for f in forces) + 1e-12
        assert report.force == pytest.approx(force, abs=1e-6 * size)
        assert report.moment == pytest.approx(moment, abs=1e-6 * 0.05 * size)
    assert compared > 6


SLIDES = """
<mujoco>
  <option timestep="2e-3"/>
  <worldbody>
    <body name="plate" euler="12 20 0">
      <joint type="slide" axis="{axis}"/><geom type="box" size="0.03 0.02 0.004" mass="0.2"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("axis", ["0 0 1", "0.6 0 -0.8"])
@pytest.mark.parametrize("speed", [-1.0, -0.3, 0.5])
def test_the_pages_give_a_step_of_a_body_on_a_slide(axis, speed):
    model = mujoco.MjModel.from_xml_string(SLIDES.format(axis=axis))
    data, sand = mujoco.MjData(model), Sand(model, medium="poppy_seed_loose")
    page, h = Page(sand.law), model.opt.timestep
    data.qpos[0], data.qvel[0] = -0.012, speed
    mujoco.mj_forward(model, data)
    along, turn = data.xaxis[0].copy(), data.xmat[1].reshape(3, 3).copy()
    place, still = data.xpos[1].copy(), np.zeros(3)
    facets, kept = facets_of(page, sand.elements, turn, place, speed * along, still, h)
    assert facets

    def unbalanced(after):
        force = sum(facet.force(after * along, kept, h) for facet in facets)
        return 0.2 * (after - speed) - h * (force - 0.2 * G * UP) @ along

    sand.step(data)
    expected = brentq(unbalanced, 1e-6 * speed, 1.1 * speed, xtol=1e-15)
    assert data.qvel[0] == pytest.approx(expected, rel=1e-4)


def test_an_end_of_a_cylinder_is_as_wide_as_the_root_of_its_area():
    geom = '<geom type="cylinder" size="0.01 0.03"/>'
    model = mujoco.MjModel.from_xml_string(HEAVY.format(geoms=geom))
    elements = Sand(model, medium="quikrete_medium").elements
    ends = elements[elements["flat"] == 1]
    assert ends["face"] == pytest.approx(math.sqrt(math.pi) * 0.01, rel=1e-3)


def test_the_froude_number_is_by_the_widest_face_of_the_body():
    half = '<geom type="box" size="0.03 0.02 0.01" pos="0 {} 0"/>'
    geoms = half.format(0) + half.format(0.04)
    model = mujoco.MjModel.from_xml_string(HEAVY.format(geoms=geoms))
    data, sand = mujoco.MjData(model), Sand(model)
    data.qvel[2] = -0.3
    mujoco.mj_forward(model, data)
    report = sand.report(data)  # a face of 6 by 8 cm, of two boxes that are 4 cm wide
    assert report["body"].froude == pytest.approx(0.3 / math.sqrt(G * 0.06))
    assert report.elements.width == pytest.approx(0.06)


def test_rays_have_the_weight_on_the_page():
    (power,) = re.findall(r"\\cos\^\{(\d+)\}", (DOCS / "shapes.md").read_text("utf-8"))
    assert len(CORNERS) * len(rigid._lobe()) == 32
    up = np.unique(rigid._lobe()[:, 2].round(12))
    # By solid angle cos^p, of which cos^(p+1) has evenly spread values.
    assert up ** (int(power) + 1) == pytest.approx((np.arange(len(up)) + 0.5) / len(up))


def test_a_wall_counts_by_its_gap_over_that_of_the_first():
    wall = '<geom type="box" size="0.1 0.1 0.005" pos="0 0 {}"/>'
    places = (0.0, 0.03, 0.05, 0.09)  # gaps of 20, 10 and 30 mm
    geoms = "".join(wall.format(z) for z in places)
    model = mujoco.MjModel.from_xml_string(HEAVY.format(geoms=geoms))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sight = rigid._Sight(model, data)
    sight.show(np.arange(4))
    ray, start = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.005 + 1e-9])
    met = sight.walls([(start, ray)], ray, 0, 0.1)
    assert met[:3] == pytest.approx([1.0, 0.5, 1.0], abs=1e-4)


@pytest.mark.parametrize("surroundings", [0.05, 0.09, 0.13, 0.26, 0.4])
def test_surroundings_are_rounded_up_to_a_divisor_of_the_extent(surroundings):
    memory = Memory(0.01)
    divisors = [n for n in range(1, memory.size + 1) if memory.size % n == 0]
    expected = min(n for n in divisors if 0.01 * n >= surroundings * (1 - 1e-9))
    assert memory.size // memory.blocks(surroundings) == expected


def test_the_depth_in_prints_is_that_of_the_page():
    plate = """<mujoco><option timestep="1e-3"/><worldbody><body name="plate"><freejoint/>
      <geom type="box" size="0.05 0.05 0.005" mass="1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(plate)
    data, cell, wide = mujoco.MjData(model), 0.01, 10
    sand = Sand(model, law="rft3d", scheme="explicit", memory=Memory(cell, surroundings=0.1))
    for height in [*np.arange(0, -0.02, -1e-3), *np.full(40, 0.05)]:
        data.qpos[2], data.time = height + 0.005, data.time + 0.01
        for _ in range(10):
            mujoco.mj_step1(model, data)
            sand.apply(data)
    prints = sand.relief(data)
    height = RegularGridInterpolator((prints.x, prints.y), prints.height)

    def weights(place, nodes):
        """The part of each node's block in a square of four blocks around a place."""
        first = np.floor_divide(np.round(nodes / cell), wide) * wide - 0.5
        low, high = place / cell - 2 * wide, place / cell + 2 * wide
        return np.clip(np.minimum(high, first + wide) - np.maximum(low, first), 0, wide) / wide

    compared, levels = 0, []
    for place in [(0, 0, -0.03), (0.03, 0.02, -0.0195), (0.13, 0.02, -0.01), (0.2, 0.1, -0.01)]:
        data.qpos[:3] = np.add(place, (0, 0, 0.005))
        mujoco.mj_forward(model, data)
        elements = sand.report(data).elements
        for x, y, z in elements.point[abs(elements.point[:, 2] - place[2]) < 1e-9]:
            around = weights(x, prints.x) @ prints.height @ weights(y, prints.y) / (4 * wide) ** 2
            levels.append(around)
            above, deep = float(height((x, y))) - z, around - z
            expected = min(above / min(0.1 * cell, deep), 1) * deep
            if above <= 0:
                continue
            at = abs(elements.point - (x, y, z)).max(axis=1).argmin()
            assert elements.depth[at] == pytest.approx(expected, abs=1e-12)
            compared += 1
    assert compared > 20
    assert max(map(abs, levels)) > 1e-5
