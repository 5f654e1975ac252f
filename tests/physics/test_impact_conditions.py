"""Stopping time and depth over many conditions, against the stiff solution."""

import math
import warnings

import numpy as np
import pytest

from mjgranular import GranularWarning, LinkLaw, Medium, Quantity
from mjgranular.experiment import Impact, run_impact

BAR = 1e-3
TIMESTEP = 5e-6  # [s], at which deviations without grazing are below 3e-5
SLOW = [(angle, speed) for angle in (10, 25) for speed in (0.5, 2.0)]


def drawn(seed, count):
    """Conditions, log-uniform in speed and uniform in all else."""
    rng = np.random.default_rng(seed)
    return [
        {
            "speed": 0.5 * 40 ** rng.random(),
            "angle": math.radians(rng.uniform(10, 75)),
            "tangential_speed": rng.uniform(-2, 2),
            "angular_velocity": rng.uniform(-15, 15),
            "length": rng.uniform(0.1, 0.4),
            "diameter": rng.uniform(0.005, 0.02),
            "density": rng.uniform(1500, 10000),
        }
        for _ in range(count)
    ]


def deviations(reference, condition):
    """Of stopping time and depth, relative; and the reference."""
    stop = run_impact(Impact(timestep=TIMESTEP, duration=0.5, **condition)).stop
    solved = reference.solve(reference.Drop(**condition))
    return abs(stop.time / solved.time - 1), abs(stop.depth / solved.depth - 1), solved


@pytest.mark.slow
def test_drawn_conditions(reference):
    grazing = 0
    for condition in drawn(seed=2024, count=10):
        time, depth, solved = deviations(reference, condition)
        assert depth < BAR, condition
        # A link that hangs in the sand at E (v_Ey = 0) and turns about it has v_Ty reach zero at a
        # grazing angle; there the creep of the explicit sign shifts the time. Measured over 120
        # draws: 3 of these miss 0.1 %, the worst by 1.7 %; and none else.
        if solved.slides_y < 0.01:
            assert time < BAR, condition
        else:
            assert time < 0.02, condition
            grazing += time >= BAR
    assert grazing <= 1


@pytest.mark.slow
def test_slow_steep_drops_that_slide(reference):
    slid = 0
    for angle, speed in SLOW:
        condition = {"angle": math.radians(angle), "speed": speed}
        time, depth, solved = deviations(reference, condition)
        assert max(time, depth) < BAR / 10, condition
        slid += solved.slides_x > 0.2
    assert slid >= 3


@pytest.mark.slow
@pytest.mark.parametrize("eta_h", [0.0, 20.0])
def test_other_sands(reference, register, eta_h):
    constants = {"eta_d": 3.0, "eta_h": eta_h, "eta_v": 10.0, "exponent": 1.4}
    quantities = {key: Quantity(value, "", "chosen") for key, value in constants.items()}
    medium = register(
        Medium(
            name="test_other_sands",
            title="for a test",
            density=Quantity(1600.0, "kg/m^3", "chosen"),
            default_law=LinkLaw.name,
            constants={LinkLaw.name: quantities},
        )
    )
    stop = run_impact(Impact(speed=3.0, angle=0.7, medium=medium.name, timestep=TIMESTEP)).stop
    solved = reference.solve(reference.Drop(speed=3.0, angle=0.7, sand_density=1600.0, **constants))
    assert stop.time == pytest.approx(solved.time, rel=BAR)
    assert stop.depth == pytest.approx(solved.depth, rel=BAR)


def test_leaning_the_other_way_is_the_mirror_image():
    one = run_impact(Impact(speed=2.0, angle=0.6, tangential_speed=0.7, angular_velocity=-3.0))
    other = run_impact(Impact(speed=2.0, angle=-0.6, tangential_speed=-0.7, angular_velocity=3.0))
    assert other.stop.time == pytest.approx(one.stop.time, rel=1e-9)
    assert other.stop.depth == pytest.approx(one.stop.depth, rel=1e-9)
    assert other.stop.x == pytest.approx(-one.stop.x, rel=1e-9)
    assert other.stop.angle == pytest.approx(-one.stop.angle, rel=1e-9)


@pytest.mark.parametrize("height", [0.02, 0.5])
def test_falling_from_a_height(height):
    # v^2 = 2 g h, t = sqrt(2 h / g), and from there on the drop that starts at the surface.
    fallen = run_impact(Impact(speed=0.0, height=height, timestep=2e-5))
    speed = math.sqrt(2 * 9.81 * height)
    released = run_impact(Impact(speed=speed, timestep=2e-5))
    assert fallen.touchdown == pytest.approx(speed / 9.81, rel=1e-4)
    assert fallen.stop.time == pytest.approx(released.stop.time, rel=1e-3)
    assert fallen.stop.depth == pytest.approx(released.stop.depth, rel=1e-3)


@pytest.mark.slow
def test_bound_on_the_time_step_is_safe(reference):
    # At the bound itself: no warning, and a result. Measured over 60 draws: median deviation
    # 0.05 %, at worst 5 %, and no run is lost before 16 times the bound.
    with warnings.catch_warnings():
        warnings.simplefilter("error", GranularWarning)
        for condition in drawn(seed=2024, count=20):  # half of them are solved above
            step = Impact(**condition).largest_step()
            stop = run_impact(Impact(timestep=step, **condition)).stop
            solved = reference.solve(reference.Drop(**condition))
            assert stop.depth == pytest.approx(solved.depth, rel=0.1), condition
