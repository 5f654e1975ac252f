"""Fits against curves that we did not compute: a sphere under F = k z + A v^2, by SciPy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mjgranular import InputError, Medium, Quantity, Rft3dLaw, calibrate
from mjgranular.calibrate import Body, Fit, Run, read_fit, read_runs, run_fit, simulate
from mjgranular.calibrate.drops import find_arrest, find_touch
from mjgranular.calibrate.intervals import correlation_time

DATA = Path(__file__).resolve().parents[2] / "referee" / "data"
MASS, STIFFNESS, QUADRATIC = 0.0692, 60.0, 0.8  # Katsuragi and Durian's sphere, about
BALL = Body("sphere", 0.0254, mass=MASS)
TRUE = {"stiffness": STIFFNESS, "quadratic": QUADRATIC}


def medium(law, **constants):
    quantities = {name: Quantity(value, "", "a guess") for name, value in constants.items()}
    return Medium("sand", "Sand", Quantity(1500.0, "kg/m^3", "a guess"), law, {law: quantities})


GUESS = medium("depth_velocity", stiffness=40.0, quadratic=0.5)
RFT = medium("rft3d", density=1500.0, internal_friction=0.5, surface_friction=0.4)


def fall(speed, rows=60, mass=MASS):
    """Times and depths of the sphere, and when it stops."""

    def stops(t, y):
        return y[1]

    stops.terminal, stops.direction = True, -1
    solution = solve_ivp(
        lambda t, y: [y[1], 9.81 - (STIFFNESS * y[0] + QUADRATIC * y[1] ** 2) / mass],
        (0.0, 1.0),
        [0.0, speed],
        events=stops,
        rtol=1e-9,
        atol=1e-12,
        dense_output=True,
    )
    stop = solution.t[-1]
    t = np.linspace(0.0, 1.3 * stop, rows)
    return t, np.where(t < stop, solution.sol(np.minimum(t, stop))[0], solution.y[0, -1]), stop


def drop(speed, noise=None, name=None, late=0.0):
    t, depth, _ = fall(speed)
    if noise is not None:
        depth = depth + 0.02 * depth.max() * noise
    data = {"time": t + late, "depth": depth}
    return Run(name or f"{speed} m/s", "drop", data, body=BALL, speed=speed)


def correlated(random, count, coefficient=0.9):
    """Noise of size one whose neighbours are alike."""
    noise = random.normal(size=count)
    for k in range(1, count):
        noise[k] = coefficient * noise[k - 1] + math.sqrt(1 - coefficient**2) * noise[k]
    return noise


def covers(result, name, value):
    low, high = result.intervals[name]
    return (low is None or low <= value) and (high is None or value <= high)


@pytest.fixture(scope="module")
def two_speeds():
    """From curves without noise, one of them with another clock, a third predicted."""
    runs = (drop(1.0), drop(3.0, late=0.25), drop(2.0))
    return run_fit(Fit(runs, GUESS, ("stiffness", "quadratic"), hold_out=("2.0 m/s",)))


def test_constants_come_back(two_speeds):
    for name, value in TRUE.items():
        assert two_speeds.values[name] == pytest.approx(value, rel=1e-3)
    assert all(two_speeds.identifiable.values())
    assert two_speeds.valleys == two_speeds.at_bound == ()


def test_times_since_1970():
    runs = (drop(1.0, late=1.7e9), drop(3.0, late=1.7e9))
    result = run_fit(Fit(runs, GUESS, ("stiffness", "quadratic")))
    assert result.values == pytest.approx(TRUE, rel=1e-3)


def test_a_record_from_before_the_release():
    """Held for 1 s, a tenth below the height of 51 mm: these rows are not those of a fall."""
    t, depth, _ = fall(1.0)
    before = np.arange(-1.1, 0.0, 1e-3)
    path = np.where(before < -1 / 9.81, -0.046, before + 9.81 / 2 * before**2)
    noise = 2e-4 * np.random.default_rng(1).normal(size=len(before))
    time, depth = np.append(before, t), np.append(path + noise, depth)
    assert find_touch(time, depth, 1.0) == pytest.approx(0.0, abs=1e-3)


def test_a_run_that_was_held_out_is_predicted(two_speeds):
    errors = two_speeds.held_out["2.0 m/s"]
    assert errors.depth == pytest.approx(0.0, abs=0.002)
    assert errors.stopping_time == pytest.approx(0.0, abs=0.02)
    assert errors.trajectory < 0.002


def test_drops_of_one_speed_leave_a_null_direction():
    random = np.random.default_rng(3)
    runs = tuple(drop(1.0, random.normal(size=60), name) for name in "ab")
    result = run_fit(Fit(runs, GUESS, ("stiffness", "quadratic")))
    assert result.identifiable == {"stiffness": False, "quadratic": False}
    assert result.correlations["stiffness"]["quadratic"] < -0.8
    assert result.valleys[0].one_speed
    change = result.valleys[0].change
    assert change["stiffness"] * change["quadratic"] < 0


def test_added_mass_counts_as_resistance_by_speed():
    fit = Fit((drop(1.0), drop(1.1)), RFT, ("strength", "added"), law="rft3d_dynamic")
    result = run_fit(fit)
    assert result.identifiable == {"strength": False, "added": False}
    assert result.valleys[0].one_speed


def test_density_and_friction_of_rft3d_are_known_by_their_product_alone():
    depth = np.linspace(0.002, 0.03, 15)
    force = 100.0 * depth
    push = Run("push", "intrude", {"depth": depth, "force": force}, body=Body("plate", 0.005, 0.02))
    result = run_fit(Fit((push,), RFT, ("density", "internal_friction")))
    assert result.runs["push"].trajectory < 1e-3
    assert result.identifiable == {"density": False, "internal_friction": False}
    assert result.correlations["density"]["internal_friction"] == pytest.approx(-1.0, abs=1e-4)
    assert result.intervals["density"] == (10.0, 25000.0)  # all that a medium may have


def test_a_constant_without_effect_is_not_determined():
    depth = np.linspace(0.002, 0.03, 10)  # a level plate pushed down does not know friction
    plate = Body("plate", 0.005, length=0.02)
    push = Run("push", "intrude", {"depth": depth, "force": 100 * depth}, body=plate)
    result = run_fit(Fit((push,), RFT, ("surface_friction",)))
    assert result.intervals == {"surface_friction": (0.0, None)}
    assert result.identifiable == {"surface_friction": False}


def test_strength_is_what_a_plate_says():
    """A flat plate moving down: 0.87574 xi_n g A z (Agarwal et al. 2023), sides and all aside."""
    depth = np.linspace(0.002, 0.03, 15)
    mu = 0.5
    xi = 1500.0 * (894 * mu**3 - 386 * mu**2 + 89 * mu) * 9.81
    force = 1.3 * 0.87574 * xi * 0.02**2 * depth
    plate = Body("plate", 0.0002, 0.02)  # thin: no sides
    push = Run("push", "intrude", {"depth": depth, "force": force}, body=plate)
    result = run_fit(Fit((push,), RFT, ("strength",)))
    assert result.values["strength"] == pytest.approx(1.3, rel=0.01)
    assert result.material.law.scale == result.values["strength"]


PLATE = Body("plate", 0.005, 0.03)


def test_a_push_has_the_speed_of_its_column():
    data = {"depth": [0.01, 0.02], "force": [1.0, 2.0]}
    measured = Run("push", "intrude", data | {"speed": [1.9, 2.1]}, body=PLATE)
    assert (measured.speed, measured.froude) == (2.0, pytest.approx(2.1 / np.sqrt(9.81 * 0.03)))
    assert Run("push", "intrude", data | {"speed": [2.0, 2.0]}, body=PLATE, speed=1.0).speed == 1.0
    assert Run("push", "intrude", data, body=PLATE).speed == 0.01


def pushed(speed, depth, force, angle=0.0):
    data = {"depth": depth, "force": force}
    return Run("push", "intrude", data, body=PLATE, speed=speed, angle=angle)


def test_an_angle_in_degrees_is_refused_with_its_unit():
    """0.3.0 took degrees in `MeasuredRun`."""
    with pytest.raises(InputError, match="angle must be from -90 to 90 degrees, got 45 rad"):
        pushed(0.01, [0.01], [1.0], angle=45)


@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_a_slow_push_under_added_mass_is_quasi_static(angle):
    """The sand that moves along is not accelerated: the plate has one speed, and does not turn."""
    depth = np.repeat(np.linspace(0.004, 0.03, 10), 2) + np.tile([-1e-5, 1e-5], 10)
    run = pushed(0.001, depth, depth, angle)
    with_mass = simulate(run, "quikrete_medium", "rft3d_dynamic").force[1::2]
    without = simulate(run, "quikrete_medium", "rft3d_dynamic added=0")
    assert with_mass == pytest.approx(without.force[1::2], rel=5e-3)


@pytest.mark.parametrize("speed", [0.05, 1.0, 3.0])
def test_a_fit_to_a_push_has_the_inertia_of_the_sand(speed):
    depth = np.linspace(0.0005, 0.03, 60)
    ends = np.append(depth - 0.00025, depth[-1] + 0.00025)  # means between rows, about `depth`
    force = simulate(pushed(speed, ends, ends), "quikrete_medium").force[1:]
    result = run_fit(Fit((pushed(speed, depth, force),), "quikrete_medium", ("strength",)))
    assert result.values["strength"] == pytest.approx(1.0, abs=0.005)
    assert result.runs["push"].trajectory < 0.02


def test_arguments_that_a_run_does_not_use_are_errors(tmp_path):
    rows = {"time": [0.0, 0.1], "depth": [-0.02, 0.02]}
    with pytest.raises(InputError, match="depth is for runs of the kind drag, not for a drop"):
        Run("ball", "drop", rows, body=BALL, speed=1.0, depth=0.1)
    with pytest.raises(InputError, match=r"must be a Body or the Path of an MJCF file, got 'leg"):
        Run("ball", "drop", rows, body="leg.xml", speed=1.0)
    with pytest.raises(InputError, match="its columns have no rows"):
        Run("ball", "drop", {"time": [], "depth": []}, body=BALL, speed=1.0)
    with pytest.raises(InputError, match=r"it begins 0.02 m above the sand"):
        simulate(Run("ball", "drop", rows, body=BALL, speed=1.0), "glass_beads")
    file = tmp_path / "runs.yaml"
    body = "{shape: sphere, diameter: 0.0254}"
    file.write_text(
        "medium: {base: quikrete_medium}\n"
        f"runs: [{{name: a, kind: intrude, height: 0.1, data: a.csv, body: {body}}}]\n"
    )
    with pytest.raises(InputError, match="height is for a drop, not for kind intrude"):
        read_fit(file)


@pytest.mark.parametrize(
    ("heading", "factor"),
    [("force [MN]", 1e6), ("force [mN]", 1e-3), ("FORCE_N", 1.0), ("Force (KN)", 1e3)],
)
def test_units_of_a_heading(heading, factor, tmp_path):
    table = tmp_path / "push.csv"
    table.write_text(f"DEPTH [MM],{heading}\n1,2\n2,3\n")
    run = Run("push", "intrude", table, body=BALL)
    assert run.motion.depth == pytest.approx([1e-3, 2e-3])
    assert run.motion.force == pytest.approx([2 * factor, 3 * factor])


def test_force_against_speed():
    speed = np.linspace(0.1, 2.0, 12)
    force = 0.3 + QUADRATIC * speed**2  # of depth_velocity, along the surface
    data = {"speed": speed, "force": force}
    drag = Run("drag", "drag", data, body=BALL, depth=0.01)
    guess = medium("depth_velocity", constant=1.0, quadratic=0.1)
    result = run_fit(Fit((drag,), guess, ("constant", "quadratic")))
    assert result.values["constant"] == pytest.approx(0.3, rel=1e-5)
    assert result.values["quadratic"] == pytest.approx(QUADRATIC, rel=1e-5)
    assert all(result.identifiable.values())


def law_of_rft(**constants):
    """The law whose constants a fit has to find."""
    return replace(Rft3dLaw.from_medium(RFT), **constants)


def test_forces_in_two_directions_of_a_turning_leg(tmp_path):
    """Thrust and lift from a file, made with the law: they determine strength and friction."""
    leg = DATA / "legs_poppy" / "flat.xml"
    (run,) = (run for run in read_runs(leg.parent).runs if run.name == "flat")
    motion = simulate(run, RFT, law_of_rft(scale=1.3, surface_friction=0.25))
    table = np.column_stack([motion.angle, motion.force, motion.lift])
    heading = "angle [deg],force [N],lift [N]"
    np.savetxt(tmp_path / "leg.csv", table, "%.9g", ",", header=heading, comments="")
    file = tmp_path / "runs.yaml"
    file.write_text(
        "medium: {density: 1500, internal_friction: 0.5, surface_friction: 0.4}\n"
        f"runs: [{{name: leg, kind: turn, speed: 0.2, data: leg.csv, body: {{file: {leg}}}}}]\n"
    )
    result = run_fit(read_fit(file, law="rft3d", free=["strength", "surface_friction"]))
    assert result.values["strength"] == pytest.approx(1.3, rel=1e-4)
    assert result.values["surface_friction"] == pytest.approx(0.25, rel=1e-3)
    assert all(result.identifiable.values())
    assert {curve.quantity for curve in result.curves["leg"]} == {"force", "lift"}


def test_lift_of_a_drag_counts():
    speed = np.linspace(0.1, 1.0, 6)
    drag = Run("drag", "drag", {"speed": speed, "force": 1.0 + speed, "lift": 0.5 + 0.0 * speed},
               body=Body("plate", 0.005, 0.02), angle=math.pi / 2, depth=0.03)  # fmt: skip
    both = run_fit(Fit((drag,), RFT, ("strength",)))
    motion = replace(drag.motion, lift=None)
    alone = run_fit(Fit((replace(drag, motion=motion),), RFT, ("strength",)))
    assert [curve.quantity for curve in both.curves["drag"]] == ["force", "lift"]
    assert [curve.quantity for curve in alone.curves["drag"]] == ["force"]
    assert both.values["strength"] != pytest.approx(alone.values["strength"], rel=1e-3)


def test_a_wheel_at_its_sinkage():
    run = read_runs(DATA / "wheel").runs[2]
    law = law_of_rft(scale=0.8, surface_friction=0.3)
    wheel = replace(run, motion=simulate(run, RFT, law))
    result = run_fit(Fit((wheel,), RFT, ("strength", "surface_friction")))
    assert result.values["strength"] == pytest.approx(0.8, rel=1e-4)
    assert result.values["surface_friction"] == pytest.approx(0.3, rel=1e-3)
    assert all(result.identifiable.values())
    assert result.runs[run.name].trajectory < 1e-4


def test_a_drop_of_a_set_is_fitted_as_that_of_a_file():
    seen = read_runs(DATA / "seen")
    run = seen["sphere 1 m/s"]
    data = {"time": run.motion.time + 1.0, "depth": run.motion.depth}
    same = Run(run.name, "drop", data, body=run.body, speed=run.speed)
    one, other = (run_fit(Fit((r,), seen.medium, ("strength",))) for r in (run, same))
    assert one.values["strength"] == pytest.approx(other.values["strength"], rel=1e-5)
    with pytest.raises(InputError, match="sphere 1 m/s': a guided body"):
        Fit((replace(run, guided=True),), seen.medium, ("strength",))
    wheel = {"model": DATA / "wheel" / "wheel.xml", "model_body": "wheel"}
    fitted = replace(run, kind="model", body=None, **wheel)
    with pytest.raises(InputError, match="can only be fitted"):
        simulate(fitted, seen.medium)


def test_names_of_before_are_aliases():
    from mjgranular import fit, referee

    assert fit.run_fit is run_fit
    assert fit.RunErrors is referee.Errors is calibrate.Errors
    assert referee.simulate is simulate


def test_a_model_of_ones_own(tmp_path):
    """The sphere as MJCF, on a slide."""
    model = tmp_path / "ball.xml"
    model.write_text(
        '<mujoco><option timestep="1e-4"/><worldbody><body name="ball" pos="0 0 0.0127">'
        '<joint type="slide" axis="0 0 1"/><geom size="0.0127" mass="0.0692"/></body></worldbody>'
        '<keyframe><key name="thrown" qvel="-2"/></keyframe></mujoco>'
    )
    t, depth, _ = fall(2.0)
    data = {"time": t, "depth": depth}
    run = Run("ball", "model", data, model=model, model_body="ball", keyframe="thrown")
    result = run_fit(Fit((run,), GUESS, ("quadratic", "stiffness")))
    for name, value in TRUE.items():
        assert result.values[name] == pytest.approx(value, rel=0.03)  # first order, 0.1 ms


def test_rows_that_count_for_one():
    random = np.random.default_rng(5)
    assert np.mean([correlation_time(random.normal(size=200)) for _ in range(50)]) < 1.5
    # (1 + a)/(1 - a) of a first-order process
    times = [correlation_time(correlated(random, 2000, 0.8)) for _ in range(20)]
    assert np.mean(times) == pytest.approx(9.0, rel=0.2)


def test_a_stop_that_the_frames_do_not_tell_is_none():
    def stop(rate, noise, seed):
        """A ball of constant deceleration, 10 mm in 20 ms."""
        t = np.arange(0.0, 0.15, 1 / rate)
        depth = 0.01 - 25.0 * np.maximum(0.02 - t, 0.0) ** 2
        off = np.random.default_rng(seed).normal(0.0, noise, len(t))
        return find_arrest(t, depth + off).time

    assert stop(240, 0.0, 0) == pytest.approx(0.02, rel=0.05)
    assert stop(2000, 3e-4, 0) == pytest.approx(0.02, rel=0.1)
    found = [stop(240, 3e-4, seed) for seed in range(20)]
    assert None in found
    assert all(time == pytest.approx(0.02, rel=0.4) for time in found if time is not None)


def test_a_record_that_begins_before_the_fall():
    """Held half a second, released 0.2 m above the sand; the clock knows nothing of it."""
    speed = math.sqrt(2 * 9.81 * 0.2)
    t, depth, _ = fall(speed)
    falling = np.arange(0.0, speed / 9.81, 0.004)
    held = np.arange(-0.5, 0.0, 0.02)
    time = np.concatenate([held, falling, t + speed / 9.81])
    above = np.concatenate([np.full(len(held), -0.2), 9.81 / 2 * falling**2 - 0.2, depth])
    data = {"time": time, "depth": above}
    run = Run("from a height", "drop", data, body=BALL, speed=speed)
    result = run_fit(Fit((run,), GUESS, ("stiffness", "quadratic")))
    for name, value in TRUE.items():
        assert result.values[name] == pytest.approx(value, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "least"), [("independent", 36), ("correlated", 34)])
def test_true_values_are_inside_their_intervals(noise, least):
    """95 % intervals, in 40 repeats with 2 % noise (of 100: 99 and 93)."""
    random = np.random.default_rng(1)
    inside = dict.fromkeys(TRUE, 0)
    for _ in range(40):
        runs = []
        for speed in (1.0, 3.0):
            e = correlated(random, 60) if noise == "correlated" else random.normal(size=60)
            runs.append(drop(speed, e))
        result = run_fit(Fit(tuple(runs), GUESS, ("stiffness", "quadratic")))
        for name, value in TRUE.items():
            inside[name] += covers(result, name, value)
    assert min(inside.values()) >= least, inside


@pytest.mark.slow
def test_runs_that_are_off_as_a_whole_are_held_against_each_other():
    """2 % of the depth by which the surface of each run lies elsewhere, in 15 repeats."""
    random = np.random.default_rng(2)
    inside = dict.fromkeys(TRUE, 0)
    for _ in range(15):
        runs = tuple(
            drop(speed, 0.3 * random.normal(size=60) + random.normal())
            for speed in (0.8, 1.3, 2.0, 2.5, 3.0)
        )
        result = run_fit(Fit(runs, GUESS, ("stiffness", "quadratic")))
        for name, value in TRUE.items():
            inside[name] += covers(result, name, value)
    assert min(inside.values()) >= 11, inside  # of 30: 25 and 29
