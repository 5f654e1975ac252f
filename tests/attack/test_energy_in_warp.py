"""The short form of `scripts/attack.py --only warp`: sand in MuJoCo Warp adds no energy."""

import importlib
from argparse import Namespace
from collections import Counter

import pytest

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco_warp")

MODELS = 8
SIZES = (12,)  # degrees of freedom: MuJoCo Warp compiles for each number


@pytest.mark.filterwarnings("ignore:Inertia matrix")
def test_sand_adds_no_energy(monkeypatch):
    """By MuJoCo's own kinematics and inverse dynamics, in double precision."""
    warp = importlib.import_module("attacks.warp")
    monkeypatch.setattr(warp, "SIZES", SIZES)
    options = Namespace(laws=None, short=False, steps=30)
    results = [warp.run(warp.draw(0, number, options)) for number in range(MODELS)]
    counts = sum((result.counts for result in results), Counter())
    assert counts["energy"] > 300
    assert counts["energy by inverse dynamics"] > 30
    assert not any(result.failures for result in results)
