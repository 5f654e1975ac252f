"""Figs 5 and 9 of the paper: how stopping time and depth go with speed and with angle."""

import math
from functools import cache

import numpy as np
import pytest

from mjgranular.experiment import Impact, Study, run_study

POINTS = 11


def sweep(over, first, last, **impact):
    impact = Impact(timestep=5e-5, **impact)
    result = run_study(Study(impact, {over: np.linspace(first, last, POINTS)}), workers=1)
    rows = list(result.rows())
    assert [row["stopped"] for row in rows] == [True] * POINTS
    return (np.array([row[name] for row in rows]) for name in ("stopping_time", "depth"))


@cache
def faster(angle):
    """Stopping times and depths at an angle [degrees], from 1 to 10 m/s."""
    return tuple(sweep("speed", 1.0, 10.0, angle=math.radians(angle)))


@pytest.mark.slow
def test_faster_stops_sooner_and_deeper():
    for angle in (30, 45, 60):
        time, depth = faster(angle)
        assert (np.diff(time) < 0).all()
        assert (np.diff(depth) > 0).all()


@pytest.mark.slow
def test_flatter_stops_sooner_and_shallower():
    for speed in (1.0, 2.0, 5.0):
        time, depth = sweep("angle", math.radians(30), math.radians(60), speed=speed)
        assert (np.diff(time) < 0).all()
        assert (np.diff(depth) < 0).all()


@pytest.mark.slow
def test_faster_sinks_less_than_in_proportion():
    # Fig. 5: ten times the speed, not twice the depth.
    _, depth = faster(45)
    assert (np.diff(depth, 2) < 0).all()
    assert depth[-1] < 2 * depth[0]
