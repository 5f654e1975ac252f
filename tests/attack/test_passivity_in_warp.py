"""The short form of `scripts/passivity.py`: sand in MuJoCo Warp gives random models no energy."""

import importlib

import pytest

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco_warp")

MODELS = 8
SIZES = (12,)  # degrees of freedom: MuJoCo Warp compiles for each number anew


@pytest.mark.filterwarnings("ignore::mjgranular.GranularWarning", "ignore:Inertia matrix")
def test_the_sand_gives_no_energy():
    """By MuJoCo's own kinematics and inverse dynamics, in double precision."""
    importlib.import_module("warp").config.log_level = importlib.import_module("warp").LOG_ERROR
    passivity = importlib.import_module("passivity")
    found = [passivity.weigh(0, number, sizes=SIZES) for number in range(MODELS)]
    assert sum(each.counts["weighed"] for each in found) > 300
    assert sum(each.counts["by inverse dynamics"] for each in found) > 30
    assert max(each.told for each in found) <= passivity.BAR
    assert max(each.felt for each in found) <= passivity.BAR
