"""Parts of facets in the sand and in the lead: against exact rational numbers and quadrature."""

import itertools
import math
from fractions import Fraction

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy import integrate

from mjgranular.law.facet_slope import load_of
from mjgranular.law.patch import immersed_part, immersed_share, leading_part

# Of every size, zero included; a middle anywhere between dry and wet, and somewhat beyond.
sizes = st.one_of(st.floats(0.01, 1), st.floats(-200, 0).map(lambda e: 10**e))
rises = st.one_of(sizes, sizes.map(lambda size: -size), st.sampled_from([0.0, 1.0, -1.0]))
places = st.floats(-1.2, 1.2)


def reach(a, b):
    return abs(a) + abs(b)


# Exact: the positive part of a linear function, integrated twice over a and b in closed form. All
# of it cancels where b is small, which is why it is done in rational numbers.


def mean_power(d, a, b, power):
    """Mean of <d + a s + b t>^power / power!, as a fraction."""
    total = Fraction(0)
    for i, j in itertools.product((1, -1), repeat=2):
        total += i * j * max(d + i * a + j * b, Fraction(0)) ** (power + 2)
    return total / (4 * a * b * math.factorial(power + 2))


def moment(d, a, b, power):
    """Mean of s <d + a s + b t>^(power - 1) / (power - 1)!: the derivative of the above by a."""
    slope = Fraction(0)
    for i, j in itertools.product((1, -1), repeat=2):
        slope += j * max(d + i * a + j * b, Fraction(0)) ** (power + 1)
    return slope / (4 * a * b * math.factorial(power + 1)) - mean_power(d, a, b, power) / a


def exact(d, a, b, power):
    d, a, b = map(Fraction, (d, a, b))
    whole = mean_power(d, a, b, power)
    first, second = moment(d, a, b, power + 1), moment(d, b, a, power + 1)
    return float(whole), float(first / whole), float(second / whole)


@pytest.mark.parametrize(("part", "power"), [(leading_part, 0), (immersed_part, 1)])
@pytest.mark.parametrize("ratio", [1.0, 0.999, 0.7, 0.1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-16, 1e-30])
def test_against_fractions(part, power, ratio):
    h = 0.37
    k = ratio * h
    near = [1e-14, 1e-7, 0.01]
    switch = [(1 - ratio) * (1 + sign * x) for x in near for sign in (1, -1)]
    for place in [-0.5, -0.1, 0.0, 1e-9, 0.3, 0.8, *(x - 1 for x in near), *(1 - x for x in near)]:
        for d in [place * (h + k), *(sign * s * h for s in switch for sign in (1, -1))]:
            if abs(d) >= h + k:
                continue
            for a, b in [(h, k), (-k, h), (h, -k)]:
                expected = exact(d, abs(a), abs(b), power)
                found = part(d, a, b)
                # What can be asked for: that much has the distance from the corner lost already.
                lost = 1e-15 / (1 - abs(d) / (h + k)) if d < 0 else 0.0
                assert found[0] == pytest.approx(expected[0], rel=1e-13 + 4 * lost)
                assert abs(found[1]) == pytest.approx(abs(expected[1]), abs=1e-13 + 4 * lost)
                assert abs(found[2]) == pytest.approx(abs(expected[2]), abs=1e-13 + 4 * lost)
                assert found[1] * a >= 0
                assert found[2] * b >= 0


def quadrature(weight, d, a, b):
    """Mean of weight(s, t) over the part of the square where d + a s + b t > 0, for b > 0."""

    def strip(s):
        low = min(max(-(d + a * s) / b, -1.0), 1.0)
        return integrate.fixed_quad(lambda t: weight(s, t), low, 1.0, n=4)[0]

    bends = [s for s in ((b - d) / a, (-b - d) / a) if -1 < s < 1]
    return integrate.quad(strip, -1, 1, points=bends or None, epsabs=1e-13, epsrel=1e-13)[0] / 4


@pytest.mark.parametrize("b", [0.05, 0.4, 1.0])
@pytest.mark.parametrize("a", [-0.6, 0.2, 1.0])
@pytest.mark.parametrize("place", [-0.9, -0.4, 0.05, 0.5, 0.95, 1.3])
def test_against_quadrature(a, b, place):
    d = place * reach(a, b)

    def depth(s, t):
        return d + a * s + b * t

    share, s, t = leading_part(d, a, b)
    assert share == pytest.approx(quadrature(lambda s, t: 1 + 0 * t, d, a, b), abs=1e-12)
    assert share * s == pytest.approx(quadrature(lambda s, t: s + 0 * t, d, a, b), abs=1e-12)
    assert share * t == pytest.approx(quadrature(lambda s, t: t, d, a, b), abs=1e-12)
    mean, s, t = immersed_part(d, a, b)
    assert mean == pytest.approx(quadrature(depth, d, a, b), abs=1e-12)
    assert mean * s == pytest.approx(quadrature(lambda s, t: s * depth(s, t), d, a, b), abs=1e-12)
    assert mean * t == pytest.approx(quadrature(lambda s, t: t * depth(s, t), d, a, b), abs=1e-12)


@given(place=places, a=rises, b=rises)
@example(place=0.0, a=0.0, b=0.0)
def test_bounds(place, a, b):
    d = place * reach(a, b)
    share, s, t = leading_part(d, a, b)
    assert 0 <= share <= 1
    assert max(abs(s), abs(t)) <= 1
    # A part within the parallelogram has its centroid where the quantity is positive.
    assert share == 0 or d + a * s + b * t >= -1e-15 * reach(a, b)
    mean, s, t = immersed_part(d, a, b)
    ulp = 1 + 1e-15
    assert max(d, 0) / ulp <= mean <= max(d + reach(a, b), 0) * ulp
    assert max(abs(s), abs(t)) <= 1


@given(place=places, a=rises, b=rises)
def test_wet_and_dry_are_the_whole(place, a, b):
    d = place * reach(a, b)
    assume(d != 0)
    up, down = leading_part(d, a, b), leading_part(-d, -a, -b)
    assert up[0] + down[0] == pytest.approx(1, abs=1e-14)
    for k in (1, 2):
        assert up[0] * up[k] + down[0] * down[k] == pytest.approx(0, abs=1e-14)
    up, down = immersed_part(d, a, b), immersed_part(-d, -a, -b)
    assert up[0] - down[0] == pytest.approx(d, abs=1e-14 * reach(a, b))
    for k, rise in ((1, a), (2, b)):
        assert up[0] * up[k] - down[0] * down[k] == pytest.approx(rise / 3, abs=1e-14 * reach(a, b))


@given(place=places, a=rises, b=rises)
def test_mirrored_and_exchanged(place, a, b):
    d = place * reach(a, b)
    for part in (leading_part, immersed_part):
        whole, s, t = part(d, a, b)
        assert part(d, -a, b) == (whole, -s, t)
        assert part(d, b, a) == pytest.approx((whole, t, s), rel=1e-15, abs=1e-15)


@given(place=places, a=rises, b=rises, step=st.floats(1e-12, 1e-2))
def test_continuous(place, a, b, step):
    scale = max(abs(a), abs(b))
    d = place * reach(a, b)
    more = d + step * scale
    rise = leading_part(more, a, b)[0] - leading_part(d, a, b)[0]
    assert -1e-15 <= rise <= 0.5 * (more - d) / max(scale, 1e-200) + 1e-14
    rise = immersed_part(more, a, b)[0] - immersed_part(d, a, b)[0]
    assert -1e-15 * scale <= rise <= (more - d) + 1e-14 * scale


@given(place=places, a=rises, b=rises)
def test_depth_grows_by_what_is_wet(place, a, b):
    scale = max(abs(a), abs(b))
    assume(scale > 0)
    d, step = place * reach(a, b), 1e-5 * scale
    slope = (immersed_part(d + step, a, b)[0] - immersed_part(d - step, a, b)[0]) / (2 * step)
    assert slope == pytest.approx(leading_part(d, a, b)[0], abs=2e-5)


@given(place=places, a=rises, b=rises)
@example(place=0.0, a=0.0, b=0.0)
def test_immersed_share_without_branches(place, a, b):
    d = place * reach(a, b)
    assert immersed_share(d, a, b) == pytest.approx(leading_part(d, a, b)[0], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("d", [-0.3, -1e-9, -0.0, 0.0, 1e-9, 0.3])
def test_point(d):
    assert immersed_share(d, 0.0, 0.0) == float(d > 0)
    assert leading_part(d, 0.0, 0.0) == (float(d > 0), 0, 0)
    assert immersed_part(d, 0.0, 0.0) == (max(d, 0), 0, 0)
    assert load_of(d, 0.0, 0.0, max(d, 0.0), 1.0, 0.0, 0.0, 1.0) == (max(d, 0), 0, 0)
    assert load_of(1.0, 0.0, 0.0, 1.0, d, 0.0, 0.0, 1.0) == (float(d > 0), 0, 0)


@given(place=places, h1=rises, h2=rises)
def test_leading_as_a_whole(place, h1, h2):
    d = place * reach(h1, h2)
    mean = immersed_part(d, h1, h2)[0]
    assert load_of(d, h1, h2, mean, 1.0, 0.5, -0.25, 1.0) == (mean, 0, 0)
    assert load_of(d, h1, h2, mean, -1.0, 0.5, -0.25, 1.0) == (0, 0, 0)


@pytest.mark.parametrize("c", [-0.8, -0.3, 0.0, 0.45, 0.9])
@pytest.mark.parametrize(("d", "h1", "h2"), [(2.0, 0.4, -0.6), (0.1, 0.4, 0.6), (-0.2, 0.7, 0.1)])
def test_edge_of_leading_along_an_edge(c, d, h1, h2):
    # What leads is a parallelogram, from s = -c to 1.
    width, middle = (1 + c) / 2, (1 - c) / 2
    load = width * immersed_part(d + middle * h1, width * h1, h2)[0]
    found = load_of(d, h1, h2, immersed_part(d, h1, h2)[0], c, 1.0, 0.0, 1.0)
    assert found == pytest.approx((load, middle, 0), abs=1e-15)


@pytest.mark.parametrize("c", [-1.2, -0.5, 0.0, 0.6, 1.1])
@pytest.mark.parametrize(("a", "b"), [(1.0, 0.4), (-0.7, 0.7), (0.2, 1.0)])
def test_in_the_sand_as_a_whole_the_load_is_exact(a, b, c):
    d, h1, h2 = 2.0, 0.3, -0.5

    def depth(s, t):
        return d + h1 * s + h2 * t

    load = load_of(d, h1, h2, immersed_part(d, h1, h2)[0], c, a, b, 1.0)[0]
    assert load == pytest.approx(quadrature(depth, c, a, b), rel=1e-12)


@given(d=places, h1=rises, h2=rises, c=places, a=rises, b=rises)
def test_bounds_of_what_acts(d, h1, h2, c, a, b):
    depth, speed = d * reach(h1, h2), c * reach(a, b)
    load, ls, lt = load_of(depth, h1, h2, immersed_part(depth, h1, h2)[0], speed, a, b, 1.0)
    assert 0 <= load <= max(depth + reach(h1, h2), 0) * (1 + 1e-15)
    assert max(abs(ls), abs(lt)) <= 1
