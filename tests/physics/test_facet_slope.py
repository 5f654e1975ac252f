"""A facet's force and its derivative in closed form, against a clipped polygon and differences.

The reference knows nothing of the kernels: it cuts the facet with a line, as a polygon, takes the
laws' formulas with angles and monomials, in extended precision where there is one, and derives by
differences of velocities.
"""

import math
from collections import Counter
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from mjgranular import DynamicRft3dLaw, Plane, Rft2dLaw, Rft3dLaw, media
from mjgranular.law import rft3d
from mjgranular.law.facet import facet_kernel
from mjgranular.law.rft import stress_of

REAL = np.longdouble
FINE = np.finfo(REAL).eps < 1e-17
STEP = REAL(1e-5 if FINE else 1e-4)
CLOSE = 1e-8 if FINE else 1e-5
G = 9.81
AREA = 0.003
RAMP = 0.05
LAWS = {
    "rft2d": Rft2dLaw.from_medium(media["poppy_seed_loose"]),
    "rft3d": Rft3dLaw.from_medium(media["quikrete_medium"]),
    "rft3d_inertia": Rft3dLaw(1500.0, 0.6, 0.2, inertia=1.1),
    "rft3d_lateral_low": Rft3dLaw(1500.0, 0.6, 0.2, lateral=0.8),
    "rft3d_lateral": Rft3dLaw(1500.0, 0.6, 0.2, lateral=1.4),
    "rft3d_lateral_high": Rft3dLaw(1500.0, 0.6, 0.2, lateral=2.4),
    "rft3d_dynamic": DynamicRft3dLaw(1500.0, 0.6, 0.2),
}
SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def unit(v):
    return v / np.sqrt(v @ v)


# The reference


def positive_part(d, a, b):
    """The square's part with d + a s + b t > 0: its share, its centroid, its mean of that."""
    corners = [(REAL(s), REAL(t), d + a * s + b * t) for s, t in SQUARE]
    kept = []
    for here, there in zip(corners, [*corners[1:], corners[0]], strict=True):
        if here[2] > 0:
            kept.append(here)
        if (here[2] > 0) != (there[2] > 0):
            x = here[2] / (here[2] - there[2])
            kept.append(tuple(p + x * (q - p) for p, q in zip(here, there, strict=True)))
    total, sums = REAL(0), np.zeros(3, REAL)
    for second, third in pairwise(kept[1:]):
        u, v = np.subtract(second, kept[0]), np.subtract(third, kept[0])
        area = (u[0] * v[1] - u[1] * v[0]) / 2
        total += area
        sums += area * np.sum([kept[0], second, third], axis=0) / 3
    if total <= 0:
        return REAL(0), REAL(0), REAL(0), REAL(0)
    return total / 4, sums[0] / total, sums[1] / total, sums[2] / 4


def stress_3d(law, n, u, z):
    down = n if n @ z <= 0 else -n
    x1, x2, x3 = -u @ z, -down @ z, down @ u
    monomials = np.array([
        1, x1, x2, x3, x1**2, x2**2, x3**2, x1 * x2, x2 * x3, x3 * x1, x1**3, x2**3, x3**3,
        x1 * x2**2, x2 * x1**2, x2 * x3**2, x3 * x2**2, x3 * x1**2, x1 * x3**2, x1 * x2 * x3,
    ])  # fmt: skip
    f1, f2, f3 = (np.array(c, REAL) @ monomials for c in (rft3d.C1, rft3d.C2, rft3d.C3))
    a = f1 * down + f2 * u - f3 * z
    along = a @ n
    t = a - along * n
    share = min(REAL(1), law["friction"] * abs(along) / np.sqrt(t @ t))
    against = max(abs(along) * (n @ u), REAL(0))
    if share * (t @ u) > against:
        share = against / (t @ u)
    more, less = sideways(law["lateral"], n, u, z)
    return law["stiffness"] * G * (less * share * t - more * abs(along) * n)


def stress_measured(law, n, u, z):
    """With K and J of (S4) and (S5)."""
    square, across, graze = (n @ z) ** 2, 1 - (u @ z) ** 2, 1 - (n @ u) ** 2
    k = 1 - REAL(0.3) * 4 * square * (1 - square) * (1 - across**2)
    return k * (1 + square * graze**8 * (1 - across**8)) * stress_3d(law, n, u, z)


def sideways(lateral, n, u, z):
    """G and T of (S2) and (S3)."""
    if lateral == 0:
        return REAL(1), REAL(1)
    q, w = max(n @ u, REAL(0)) ** 8, (1 - (u @ z) ** 2) * (1 - (n @ z) ** 2)
    more = 1 + (lateral * (1 + q) / 2 - 1) * w
    less = min(lateral / 2 - 1, REAL(0)) * (1 - q) + min(lateral - 1, REAL(0)) * q
    return more, 1 + less * w


def stress_2d(law, n, u, z):
    e = n - (n @ z) * z
    if np.sqrt(e @ e) < 1e-3:
        e = u - (u @ z) * z
        b = REAL(0)
        # As the kernel has it: the plate's own cosine, and no sine.
        double = (n @ z) ** 2, REAL(0)
    else:
        b = np.arctan2(unit(e) @ n, -(n @ z))
        double = np.cos(2 * b), np.sin(2 * b)
    e = unit(e)
    g = np.arctan2(-(u @ z), u @ e)
    cos_p = double[0] * np.cos(g) - double[1] * np.sin(g)
    cos_m = double[0] * np.cos(g) + double[1] * np.sin(g)
    sin_p = double[1] * np.cos(g) + double[0] * np.sin(g)
    sin_m = -double[1] * np.cos(g) + double[0] * np.sin(g)
    up = law["A00"] + law["A10"] * double[0] + law["B11"] * sin_p
    up += law["B01"] * np.sin(g) + law["Bm11"] * sin_m
    back = law["C11"] * cos_p + law["C01"] * np.cos(g) + law["Cm11"] * cos_m
    back += law["D10"] * double[1]
    aside = u - (u @ z) * z - (u @ e) * e
    w = np.sqrt(aside @ aside)
    least = REAL(0.973746396532650), REAL(1.60910808139526)
    share = np.arctanh(REAL(1.61146827229181) * np.hypot(u @ e, u @ z) - least[0])
    share = REAL(1.99392673405210) / REAL(5.81083560370960) * (share + np.arctanh(least[0]))
    slip = np.tanh(REAL(3.62263982880971) * w - least[1]) + np.tanh(least[1])
    slip *= REAL(0.440850096954369) / REAL(0.832324700111401) * law["side"] / w
    return law["scale"] * G * (share * (up * z - back * e) - slip * aside)


STRESS = {"rft2d": stress_2d, "rft3d_dynamic": stress_measured}


@dataclass
class Facet:
    """A facet in the sand; see `law.facet.FacetSample` for its numbers."""

    normal: np.ndarray
    up: np.ndarray
    spread: np.ndarray
    depth: float
    rises: tuple[float, float]
    push: float
    skips: np.ndarray
    along: np.ndarray
    turns: tuple[float, ...] = (0.0, 0.0, 0.0)
    rubs: float = 0.0
    slides: float = 0.0
    cone: float = 0.3

    def immersed(self):
        mean = positive_part(REAL(self.depth), *map(REAL, self.rises))[3]
        return np.array([
            1.0, 0.0, 0.0, 0.0, 0.0, *self.normal, *self.up, *self.spread[0], *self.spread[1],
            self.depth, *self.rises, float(mean), AREA, self.cone, self.push, 0.0, 0.0,
            *self.skips, *self.along, self.rubs, self.slides, *self.turns,
        ])  # fmt: skip

    def rates(self, u):
        """c, a and b, on the ramp what is taken in their place."""
        c = self.normal.astype(REAL) @ u + self.turns[0]
        a, b = self.spread.astype(REAL) @ u - self.turns[1:]
        if abs(a) + abs(b) < RAMP:
            a = np.copysign(REAL(RAMP) - abs(b), a)
        return c, a, b

    def sided(self, u):
        """The share of a of `rates` that is not the ramp's."""
        a, b = abs(self.spread.astype(REAL) @ u - self.turns[1:])
        return a / (RAMP - b) if a + b < RAMP else REAL(1)

    def force(self, stress, law, u):
        n, z, spread = (x.astype(REAL) for x in (self.normal, self.up, self.spread))
        share, s, t, _ = positive_part(*self.rates(u))
        s *= self.sided(u)
        (h, k), f, e = self.rises, 1 - abs(s), 1 - abs(t)
        load = share * positive_part(self.depth + s * h + t * k, f * h, e * k)[3]
        if load <= 0:
            return np.zeros(3, REAL)
        m = n + s * spread[0] + t * spread[1]
        leads = (n @ u + self.turns[0] + (spread @ u - self.turns[1:]) @ [s, t]) / np.sqrt(m @ m)
        m = unit(m)
        e, d = (x - (x @ m) * m for x in (self.along, self.skips))
        w = unit(u - (e @ u) * d + (leads - m @ u) * m) if self.slides > 0 else u
        found = stress(law, m, w, z) * (1 + self.cone * (w @ z) ** 2)
        found -= max(found @ w, REAL(0)) * w
        return AREA * load * (self.opposed(found, m, u) if self.slides > 0 else found)

    def opposed(self, found, m, u):
        """A share of the traction against the motion along the skin, at least one that slows it."""
        traction, along = found - (found @ m) * m, u - (u @ m) * m
        against = -np.sqrt(traction @ traction) * along
        against /= max(np.sqrt(along @ along), REAL(self.slides))
        share, gain = REAL(self.rubs), found @ u
        if gain > 0:
            share = max(share, min(gain / ((traction - against) @ u), REAL(1)))
        found = found + share * (against - traction)
        return found - max(found @ u, REAL(0)) * u

    def soft(self, stress, law, v, eps):
        """The whole force at a velocity: static part made soft, and inertial push."""
        speed = np.sqrt(v @ v)
        n = self.normal.astype(REAL)
        vn = max(v @ n, REAL(0))
        static = speed / np.sqrt(v @ v + eps * eps) * self.force(stress, law, v / speed)
        return static - self.push * vn * vn * n


def branch(d, a, b):
    """Which of the formulas is in force."""
    d, h, k = float(d), *sorted((abs(float(a)), abs(float(b))), reverse=True)
    if abs(d) >= h + k:
        return "all" if d > 0 else "none"
    if abs(d) <= h - k:
        return "trapezium"
    return "all but a corner" if d > 0 else "corner"


def drawn(rng, slides=False):
    """A facet, and a direction that may cut it."""
    n, z = unit(rng.normal(size=3)), unit(rng.normal(size=3))
    turns = rng.normal(size=(2, 3))
    turns -= np.outer(turns @ n, n)
    spread = (
        turns * (rng.choice([0.0, 1.0], 2, p=[0.15, 0.85]) * 10 ** rng.uniform(-2, 0, 2))[:, None]
    )
    rises = tuple(rng.choice([0.0, 1.0], 2, p=[0.15, 0.85]) * rng.normal(size=2) * 0.02)
    reach = abs(rises[0]) + abs(rises[1])
    depth = rng.uniform(-0.6, 1.2) * (reach if rng.random() < 0.8 else 0.05)
    push, still = rng.choice([0.0, 0.4]), np.zeros(3)
    facet = Facet(n, z, spread, depth, rises, push, still, still)
    if slides:
        facet.skips, facet.along = np.cross(n, rng.normal(size=3)), unit(np.cross(z, n))
        facet.skips *= rng.random()
        facet.rubs, facet.slides = rng.random(2)
        facet.turns = (0.01 * rng.normal(), *(rng.normal(size=2) * np.linalg.norm(spread, axis=1)))
    across = unit(np.cross(n, rng.normal(size=3)))
    widest = max(float(np.abs(spread @ across).sum()), RAMP)
    sine = np.clip(rng.uniform(-1.05, 1.2) * widest, -0.99, 0.99)
    return facet, sine * n + math.sqrt(1 - sine**2) * across


def derivative(function, v, speed):
    """By central differences, two steps together; None next to an edge of the law."""
    rows = []
    for step in (speed * STEP, speed * STEP / 2):
        rows.append(
            np.array(
                [
                    (function(v + step * axis) - function(v - step * axis)) / (2 * step)
                    for axis in np.eye(3, dtype=REAL)
                ]
            ).T
        )
    coarse, fine = rows
    both = fine + (fine - coarse) / 3
    return None if abs(fine - coarse).max() > 3e-4 * abs(fine).max() else both


@pytest.mark.slow
@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_against_polygons_and_differences(kernels, name, slides):
    law = LAWS[name]
    kernel, record = (
        kernels.Kernels(law.kernel(Plane())),
        law.parameters(media["quikrete_medium"])[0],
    )
    stress = STRESS.get(name, stress_3d)
    rng = np.random.default_rng(3)
    leading, wet = Counter(), Counter()
    count, off = 250, []
    for _ in range(count):
        facet, u = drawn(rng, slides)
        speed, eps = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-2, 0)
        v = speed * u
        p = v / math.sqrt(v @ v + eps * eps)
        answer = kernel.respond(facet.immersed(), record, G, v, p, eps)
        assert np.isfinite(answer).all()
        assert answer[12] < 1e-25  # the grip is the velocity's own

        force = partial(facet.soft, stress, record, eps=REAL(eps))
        v = v.astype(REAL)
        expected = force(v)
        size = 1e-12 + float(abs(expected).max())
        assert answer[:3] == pytest.approx(expected.astype(float), rel=0, abs=1e-11 * size)
        found = derivative(force, v, speed)
        if found is None:
            continue
        slope = -np.array(answer[3:12]).reshape(3, 3)
        size = 1e-12 + float(abs(found).max())
        rates = facet.rates(v / np.sqrt(v @ v))
        leading[branch(*rates)] += 1
        # How the slip turns with the part of a facet that leads is omitted.
        if not slides or branch(*rates) in ("all", "none"):
            off.append(abs(slope - found.astype(float)).max() / size)
        if expected.any():
            wet[branch(facet.depth, *facet.rises)] += 1
    # Nor how the traction is turned farther, so as not to add energy, which is rare.
    assert np.percentile(off, 95 if slides else 100) < CLOSE
    assert leading.total() > 0.9 * count
    assert min(leading[x] for x in ("none", "all", "trapezium", "corner", "all but a corner")) > 4
    assert min(wet[x] for x in ("all", "trapezium", "corner", "all but a corner")) > 4


@pytest.mark.parametrize("name", LAWS)
def test_a_facet_begins_to_lead_as_a_whole_without_a_jump(kernels, name):
    # Up to rounding: the quicker kernel may answer for any block whose facets all lead.
    law = LAWS[name]
    kernel, record = (
        kernels.Kernels(law.kernel(Plane())),
        law.parameters(media["quikrete_medium"])[0],
    )
    rng = np.random.default_rng(4)
    for margin in np.repeat((0.0, 1e-14, 1e-9, 1e-3, 0.3), 20):
        facet, u = drawn(rng)
        across = unit(u - (facet.normal @ u) * facet.normal)

        def bare(sine, facet=facet, across=across):
            u = sine * facet.normal + math.sqrt(1 - sine**2) * across
            return sine - max(float(np.abs(facet.spread @ u).sum()), RAMP)

        low, high = 0.0, 1.0
        while high - low > 1e-16:
            middle = (low + high) / 2
            if middle in (low, high):
                break
            low, high = (middle, high) if bare(middle) < 0 else (low, middle)
        sine = min(high + margin, 1.0)
        v = 0.7 * (sine * facet.normal + math.sqrt(1 - sine**2) * across)
        p = 0.8 * v
        full, simple = (
            kernel.respond(facet.immersed(), record, G, v, p, 1e-3, simple=quicker)
            for quicker in (False, True)
        )
        assert full[:3] == pytest.approx(simple[:3], rel=0, abs=1e-12 * abs(simple[:3]).max())
        # At the edge itself, where a derivative of what leads has a kink, no more than that.
        if margin > 1e-12:
            assert kernel.complexity(facet.immersed(), record, p, 1e-3) == 1
            # Nearly in the plane of n and z the two-dimensional law enlarges rounding.
            close = 1e-9 if name.startswith("rft2d") else 1e-12
            assert full == pytest.approx(simple, rel=0, abs=close * abs(simple).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rft2d", "rft3d"])
def test_without_a_slope_there_are_differences(kernels, name):
    law = LAWS[name]
    other = facet_kernel(Plane.probe, stress=stress_of(law.slope))
    assert other.complexity is None
    closed, other = kernels.Kernels(law.kernel(Plane())), kernels.Kernels(other)
    record = law.parameters(media["quikrete_medium"])[0]
    rng = np.random.default_rng(5)
    alike = 0
    for _ in range(200):
        facet, u = drawn(rng)
        v, p = 0.7 * u, 0.6 * u
        a, b = (
            kernel.respond(facet.immersed(), record, G, v, p, 1e-2) for kernel in (closed, other)
        )
        scale = abs(a).max()
        alike += abs(a - b).max() < 1e-4 * scale
    assert alike > 190
