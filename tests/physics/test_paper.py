"""The paper's six drops, run through MuJoCo, against the numbers it prints."""

import math
import re
from pathlib import Path

import pytest

from mjgranular import Sand
from mjgranular.experiment import Impact, run_impact


def drops(paper, timestep):
    """Yield the six cases with their runs."""
    for case in paper["cases"]:
        angle = math.radians(case["angle"])
        yield case, run_impact(Impact(speed=case["speed"], angle=angle, timestep=timestep))


@pytest.fixture(scope="module")
def at_a_microsecond(paper):
    """The six cases at a microsecond, run once."""
    return list(drops(paper, 1e-6))


def test_constants_are_the_papers(paper):
    constants, impact = paper["constants"], Impact()
    model = impact.link.model(1e-5)
    sand = Sand(model, impact.described)
    assert impact.length == constants["length"]
    assert impact.diameter == constants["diameter"]
    assert impact.density == constants["link_density"]
    assert sand.medium.density.value == constants["sand_density"]
    assert sand.law.eta_d == constants["eta_d"]
    assert sand.law.eta_h == constants["eta_h"]
    assert sand.law.eta_v == constants["eta_v"]
    assert sand.law.exponent == constants["lambda"]
    assert model.opt.gravity.tolist() == [0, 0, -constants["gravity"]]


def test_link_is_the_papers_slender_rod(paper, reference):
    model, drop = Impact().link.model(1e-5), reference.Drop()
    body = model.body("link")
    assert body.mass[0] == pytest.approx(drop.mass, rel=1e-12)
    assert body.inertia[:2] == pytest.approx([drop.inertia] * 2, rel=1e-12)
    (rod,) = Sand(model, Impact().described).elements
    assert 2 * rod["half_length"] == pytest.approx(paper["constants"]["length"], rel=1e-12)
    assert rod["width"] == pytest.approx(paper["constants"]["diameter"], rel=1e-12)


@pytest.mark.slow
def test_six_cases_at_a_microsecond(paper, at_a_microsecond):
    printed, solved = paper["tolerance"]["printed"], paper["tolerance"]["solved"]
    for case, result in at_a_microsecond:
        assert result.stop.time == pytest.approx(case["time"], abs=printed["time"])
        assert result.stop.depth == pytest.approx(case["depth"], abs=printed["depth"])
        assert result.stop.time == pytest.approx(case["solved_time"], abs=2 * solved["time"])
        assert result.stop.depth == pytest.approx(case["solved_depth"], abs=solved["depth"])


@pytest.mark.slow
def test_the_table_of_the_link_law_has_what_is_found(at_a_microsecond):
    row = r"^\| ([\d.]+) \| (\d+)° \| ([\d.]+) \| ([\d.]+) \| [\d.]+ \| ([\d.]+) \| ([\d.]+) \|"
    page = Path(__file__).resolve().parents[2] / "docs" / "laws" / "link.md"
    rows = re.findall(row, page.read_text(), re.MULTILINE)
    assert len(rows) == 6
    for (speed, angle, *shown), (case, result) in zip(rows, at_a_microsecond, strict=True):
        assert (float(speed), float(angle)) == (case["speed"], case["angle"])
        found = [case["time"], result.stop.time, case["depth"], result.stop.depth]
        assert [f"{value:.6f}" for value in found] == shown


@pytest.mark.parametrize("timestep", [1e-4, 1e-5])
def test_six_cases_within_a_hundredth(paper, timestep):
    bar = paper["tolerance"]["coarse"]["relative"]
    for case, result in drops(paper, timestep):
        assert result.stop.time == pytest.approx(case["time"], rel=bar)
        assert result.stop.depth == pytest.approx(case["depth"], rel=bar)
