"""One drop: what it takes, what it keeps, how it ends."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjgranular.experiment
from mjgranular import GranularWarning, InputError, UnknownNameError, UnstableError
from mjgranular.experiment import Impact, run_impact
from mjgranular.experiment.sampling import Recorder
from mjgranular.experiment.trajectory import Trajectory

NOT_NUMBERS = [math.nan, math.inf, -math.inf]
POSITIVE = {name: name for name in ("length", "diameter", "density", "duration")}
POSITIVE["timestep"] = "time step"


# What it takes


@pytest.mark.parametrize(
    ("name", "bad", "told"),
    [
        *[
            (name, bad, f"{name} must be finite")
            for name in ("speed", "angle", "tangential_speed", "angular_velocity", "height")
            for bad in NOT_NUMBERS
        ],
        *[
            (name, bad, f"{told} must be positive and finite")
            for name, told in POSITIVE.items()
            for bad in [*NOT_NUMBERS, 0.0, -1.0]
        ],
        ("speed", -1e-9, "must not be negative"),
        ("angle", math.pi / 2, "less than 90 degrees"),
        ("angle", -2.0, "less than 90 degrees"),
        ("angle", 45.0, "less than 90 degrees"),
        ("height", -1e-9, "0 or more"),
        ("diameter", 0.5, "longer than it is thick"),
        ("until", "tomorrow", "stop, rest"),
    ],
)
def test_bad_values_are_told_apart(name, bad, told):
    with pytest.raises(InputError, match=told):
        Impact(**{name: bad})


@pytest.mark.parametrize(
    ("name", "known"), [("medium", "play_sand"), ("law", "link"), ("scheme", "explicit")]
)
def test_bad_names_are_told_the_good(name, known):
    with pytest.raises(UnknownNameError, match=known):
        Impact(**{name: "nonesuch"})


# How it ends


@pytest.mark.parametrize("timestep", [1e-2, 5e-3])
@pytest.mark.parametrize("until", ["stop", "rest"])
@pytest.mark.parametrize("speed", [10.0, 50.0])
def test_too_large_a_step_is_an_error(timestep, until, speed):
    impact = Impact(timestep=timestep, until=until, speed=speed)
    with (
        pytest.warns(GranularWarning, match="above .* the bound"),
        pytest.raises(UnstableError, match=r"too large.*below .* s it is sure to be stable"),
    ):
        run_impact(impact)


def test_warning_above_the_bound_only():
    impact = Impact()
    bound = impact.largest_step()
    with pytest.warns(GranularWarning, match="explicit"):
        run_impact(Impact(timestep=bound * 1.01))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run_impact(Impact(timestep=bound * 0.99))


def test_the_bound_is_that_of_the_law_with_its_parameters():
    stronger = "link eta_d=13 eta_h=8 eta_v=22 exponent=1.1"  # play_sand has an eta_d of 6.5
    bound = Impact(law=stronger).largest_step()
    assert bound == pytest.approx(Impact().largest_step() / 2)
    other = Impact(medium="quikrete_medium", law=stronger)  # a medium without these constants
    assert other.largest_step() == pytest.approx(bound * 2500 / 1550)


@given(
    speed=st.floats(0, 50),
    length=st.floats(0.05, 1),
    density=st.floats(500, 20000),
    factor=st.floats(1.1, 3),
)
def test_bound_falls_with_speed_and_rises_with_mass(speed, length, density, factor):
    bound = Impact(speed=speed, length=length, density=density).largest_step()
    faster = Impact(speed=speed * factor, length=length, density=density).largest_step()
    denser = Impact(speed=speed, length=length, density=density * factor).largest_step()
    assert faster <= bound
    assert denser == pytest.approx(bound * factor)


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning")
@pytest.mark.parametrize("timestep", [1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2, 3e-2])
def test_never_a_number_that_is_none(timestep):
    for speed in (1.0, 10.0, 40.0):
        try:
            result = run_impact(Impact(timestep=timestep, speed=speed, until="rest", duration=1.0))
        except UnstableError:
            continue
        assert np.isfinite(result.trajectory.table()).all()
        assert all(
            math.isfinite(value) for value in result.summary().values() if isinstance(value, float)
        )


def test_no_stop_within_the_duration_is_a_result():
    result = run_impact(Impact(duration=1e-3))
    assert result.stop is None
    assert result.summary()["stopped"] is False
    assert result.summary()["stopping_time"] is None
    assert result.summary()["depth"] == result.trajectory.y_T.max() > 0


def test_never_touching_is_a_result():
    result = run_impact(Impact(height=10.0, speed=0.0, duration=0.1))
    assert result.touchdown is None
    assert result.stop is None
    # z = -g t^2 / 2, exact for the leapfrog.
    fallen = result.trajectory.z[0] - result.trajectory.z[-1]
    assert fallen == pytest.approx(9.81 * 0.1**2 / 2, rel=1e-9)


def test_comes_to_rest_after_it_stops():
    # With the distributed law: the lumped one does not resist turning about E.
    impact = Impact(speed=2.0, law="link_distributed", timestep=5e-5)
    result = run_impact(replace(impact, until="rest"))
    assert result.stop == run_impact(impact).stop
    assert result.rest.time > result.stop.time
    t = result.trajectory
    still = t.t > result.rest.time + 1e-3
    assert still.sum() > 2
    assert np.ptp(t.y_T[still]) < 1e-4


# What it keeps


@pytest.fixture(scope="module")
def drop():
    return run_impact(Impact(speed=5.0, angle=0.9, timestep=1e-6))


def test_summary_is_the_stop(drop):
    summary = drop.summary()
    assert summary["stopping_time"] == drop.stop.time
    assert summary["depth"] == drop.stop.depth
    assert summary["stopped"] is True
    assert summary["angle_deg"] == pytest.approx(math.degrees(0.9))
    assert summary["law"] == "link"
    assert summary["steps"] == drop.steps


def test_trajectory_begins_at_release_and_ends_at_the_stop(drop):
    t = drop.trajectory
    assert (t.t[0], t.x_T[0], t.y_T[0], t.v_Tx[0], t.v_Ty[0]) == pytest.approx((0, 0, 0, 0, 5))
    assert t.t[-1] == pytest.approx(drop.stop.time, abs=2e-6)
    assert t.y_T[-1] == pytest.approx(drop.stop.depth, rel=1e-6)
    assert (np.diff(t.t) > 0).all()
    assert (np.diff(t.y_T[:-1]) > 0).all()  # the last sample is within a step after the stop


def test_trajectory_is_consistent_in_itself(drop):
    t, half = drop.trajectory, 0.1
    assert t.x_T == pytest.approx(t.x + half * np.sin(t.q))
    assert t.y_T == pytest.approx(-t.z + half * np.cos(t.q))
    assert t.length == pytest.approx(t.y_T / np.cos(t.q))
    # Rates against differences of what they are rates of.
    for position, velocity in ((t.x, t.vx), (t.z, t.vz), (t.q, t.omega), (t.y_T, t.v_Ty)):
        middle = (velocity[1:] + velocity[:-1]) / 2
        rate = np.diff(position) / np.diff(t.t)
        assert rate == pytest.approx(middle, abs=2e-3 * np.abs(velocity).max())


def test_sand_takes_what_the_link_loses(drop):
    # Work of the sand against the energy of the link: an account that no kernel keeps.
    t = drop.trajectory
    work = np.sum((t.power[1:] + t.power[:-1]) / 2 * np.diff(t.t))
    assert work < 0
    assert t.energy[-1] - t.energy[0] == pytest.approx(work, rel=1e-3)
    assert (np.diff(t.energy) <= 1e-9 * t.energy[0]).all()


def test_newtons_second_law_along_the_trajectory(drop):
    t, link = drop.trajectory, drop.impact.link
    dt = np.diff(t.t)
    middle = [(f[1:] + f[:-1]) / 2 for f in (t.F_x, t.F_y, t.M)]
    expected = [middle[0] / link.mass, -middle[1] / link.mass - 9.81, middle[2] / link.inertia]
    for velocity, acceleration in zip((t.vx, t.vz, t.omega), expected, strict=True):
        found = np.diff(velocity) / dt
        # But for the steps in which a static force sets in or turns over.
        close = np.abs(found - acceleration) < 5e-3 * np.abs(acceleration).max()
        assert close.mean() > 0.99


def test_trajectory_can_be_written_and_read(drop, tmp_path):
    t = drop.trajectory
    t.write_npz(tmp_path / "t.npz")
    again = Trajectory.read_npz(tmp_path / "t.npz")
    assert np.array_equal(again.table(), t.table())


def test_same_drop_same_numbers():
    one, other = run_impact(Impact()), run_impact(Impact())
    assert np.array_equal(one.trajectory.table(), other.trajectory.table())
    assert one.summary() == other.summary()


def test_public_names_resolve():
    assert mjgranular.experiment.Impact is Impact


# The recorder


@given(steps=st.integers(0, 3000), half=st.integers(1, 40))
def test_recorder_thins_evenly(steps, half):
    keep = 2 * half
    recorder = Recorder(2, keep=keep)
    for step in range(steps):
        if recorder.due():
            recorder.take(float(step), np.array([2.0 * step]))
    rows = recorder.rows()
    assert rows.shape == (len(rows), 2)
    assert len(rows) <= keep
    if steps <= keep:
        assert rows[:, 0].tolist() == list(range(steps))
        return
    assert len(rows) > half
    gaps = np.diff(rows[:, 0])
    stride = gaps[0] if len(gaps) else 1
    assert rows[0, 0] == 0
    assert (gaps == stride).all()
    assert math.log2(stride).is_integer()
    assert steps - 1 - rows[-1, 0] < stride
    assert (rows[:, 1] == 2 * rows[:, 0]).all()


@pytest.mark.parametrize("body", ["box", "plate", "cylinder"])
def test_depth_at_rest_is_that_of_the_lowest_point(body):
    impact = Impact(
        body=body,
        medium="quikrete_medium",
        law="rft3d",
        scheme="implicit",
        speed=0.5,
        timestep=1e-3,
        duration=2.0,
        until="rest",
    )
    result = run_impact(impact)
    assert result.rest is not None
    path, (x, _, z) = result.trajectory, impact.link.halves
    q = float(path.q[-1])
    reach = x * abs(math.sin(q)) + z * abs(math.cos(q))  # of the section in the plane of motion
    assert result.rest.depth == pytest.approx(reach - path.z[-1], abs=1e-5)


def test_recorder_takes_what_is_not_due():
    recorder = Recorder(1, keep=4)
    for value in range(5):
        recorder.take(float(value))
    assert recorder.rows()[-1, 0] == 4
    recorder.rows()[:] = -1  # a copy
    assert recorder.rows()[-1, 0] == 4
