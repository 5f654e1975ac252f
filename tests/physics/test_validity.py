"""Where a law holds: the measures, worked out by hand."""

import dataclasses
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjgranular import DepthVelocityLaw, HeightField, Plane, Quantity, Rft2dLaw, Sand, laws, media
from mjgranular.experiment.drop import BodySummary
from mjgranular.law import Finding, Limit, Standing
from mjgranular.law.validity import found_at

GENERIC = Rft2dLaw.generic(1.0)
GRAIN = 0.0003  # of the glass beads


def body(geoms, gravity=9.81):
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option gravity='0 0 {-gravity}'/><worldbody><body name='body'><freejoint/>"
        f"{geoms}</body></worldbody></mujoco>"
    )


BOX = "<geom name='box' type='box' size='.04 .03 .02'/>"


def moving(model, *, velocity=(0, 0, -0.5), height=-0.1, spin=(0, 0, 0), **options):
    """The measures of a moving body by their names, and its report."""
    options = {"law": GENERIC, "medium": "glass_beads", **options}
    sand = Sand(model, **options, scheme="explicit")
    data = mujoco.MjData(model)
    data.qpos[2], data.qvel[:3], data.qvel[3:] = height, velocity, spin
    report = sand.report(data)
    (found,) = report.bodies
    return {standing.limit.measure: standing for standing in found.validity}, report


def test_measures_by_hand():
    # A box of 8 x 6 x 4 cm: its width is 6 cm. From 0.08 to 0.12 m deep, at 0.5 m/s.
    found, _ = moving(body(BOX))
    assert found["froude"].value == pytest.approx(0.5 / math.sqrt(9.81 * 0.06))  # 0.652
    assert found["depth_over_width"].value == pytest.approx(0.12 / 0.06)  # 2
    # Shear rate v/w, pressure rho g z: largest at the upper face.
    expected = 0.5 / 0.06 * GRAIN / math.sqrt(9.81 * 0.08)  # 0.00282
    assert found["inertial_number"].value == pytest.approx(expected)
    assert found["slope"].value == 0
    assert not found["froude"].holds
    assert found["inertial_number"].holds
    assert found["depth_over_width"].holds


@pytest.mark.parametrize(
    ("geom", "width"),
    [
        ("type='sphere' size='.04'", 0.08),
        ("type='capsule' size='.01 .1'", 0.02),
        ("type='cylinder' size='.05 .01'", 0.1),
        ("type='cylinder' size='.01 .05'", 0.02),
        ("type='ellipsoid' size='.06 .04 .02'", 0.08),
        ("type='box' size='.05 .005 .05'", 0.1),
    ],
)
def test_froude_number_is_of_the_width(geom, width):
    model = body(f"<geom {geom}/>")
    for law in (GENERIC, DepthVelocityLaw(constant=1.0)):
        _, report = moving(model, law=law, height=-0.3)
        assert report.bodies[0].froude == pytest.approx(0.5 / math.sqrt(9.81 * width))
        for element in report.elements:
            assert element.width == pytest.approx(width)


@pytest.mark.parametrize("speed", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("gravity", [1.62, 9.81])
def test_froude_number_goes_with_speed_and_gravity(speed, gravity):
    found, _ = moving(body(BOX, gravity), velocity=(speed, 0, 0))
    assert found["froude"].value == pytest.approx(speed / math.sqrt(gravity * 0.06))
    assert found["froude"].holds == (speed / math.sqrt(gravity * 0.06) <= 0.4)
    inertial = speed / 0.06 * GRAIN / math.sqrt(gravity * 0.08)
    assert found["inertial_number"].value == pytest.approx(inertial)


def test_inertial_number_is_that_of_its_formula():
    # (|v| / w) d sqrt(rho / p), p = rho g z: the density cancels.
    rho = media["glass_beads"].density.value
    found, report = moving(body(BOX))
    values = [
        0.5 / 0.06 * GRAIN * math.sqrt(rho / (rho * 9.81 * element.depth))
        for element in report.elements
    ]
    assert found["inertial_number"].value == pytest.approx(max(values))


def test_fastest_element_counts():
    # Turning about y at 10 rad/s: a corner of the box's ends is the farthest element's middle.
    found, report = moving(body(BOX), velocity=(0, 0, 0), spin=(0, 10, 0))
    points = np.array([element.point for element in report.elements]) - [0, 0, -0.1]
    fastest = 10 * np.hypot(points[:, 0], points[:, 2]).max()
    assert found["froude"].value == pytest.approx(fastest / math.sqrt(9.81 * 0.06))


def test_elements_above_the_sand_do_not_count():
    # The quick end is in the air.
    geoms = "<geom type='sphere' size='.02' pos='0 0 -.1'/><geom type='sphere' size='.02'/>"
    found, _ = moving(body(geoms), velocity=(0, 0, 0), spin=(0, 10, 0), height=0.05)
    assert 0.5 < found["froude"].value * math.sqrt(9.81 * 0.04) < 1.25
    found, _ = moving(body(geoms), height=0.2)
    assert found["froude"].value == 0
    assert found["depth_over_width"].value == 0
    assert found["inertial_number"].value == 0
    assert all(standing.holds for standing in found.values())


def test_each_geom_has_its_own_width():
    geoms = "<geom type='sphere' size='.02'/><geom type='sphere' size='.05' pos='0 0 -.1'/>"
    found, report = moving(body(geoms), height=-0.2)
    assert found["froude"].value == pytest.approx(0.5 / math.sqrt(9.81 * 0.04))
    ratios = [element.depth / element.width for element in report.elements]
    assert found["depth_over_width"].value == pytest.approx(max(ratios))


@pytest.mark.parametrize("slope", [-20, 0, 9.9, 10.1, 20])
def test_slope(slope):
    found, report = moving(body(BOX), height=-0.2, surface=Plane(slope=math.radians(slope)))
    assert found["slope"].value == pytest.approx(math.radians(abs(slope)))
    assert found["slope"].holds == (abs(slope) <= 10)
    assert not report.bodies[0].valid  # the speed


def test_slope_of_dunes():
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <asset><hfield name='dunes' nrow='3' ncol='3' size='1 1 1 .1'/></asset>
          <worldbody>
            <geom name='dunes' type='hfield' hfield='dunes' pos='0 0 -.5'/>
            <body name='body'><freejoint/>{BOX}</body>
          </worldbody>
        </mujoco>""")
    model.hfield_data[:] = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [0.75, 0.75, 0.75]]).ravel()
    # A law that other tests compile for height fields.
    given = {"law": "rft3d", "medium": "quikrete_medium"}
    found, _ = moving(model, surface=HeightField("dunes"), **given)
    assert found["slope"].value == pytest.approx(math.atan(0.25))


def test_without_a_grain_size_the_inertial_number_is_not_known():
    found, _ = moving(body(BOX), medium="quikrete_medium")
    assert media["quikrete_medium"].grain is None
    assert found["inertial_number"].value is None
    assert found["inertial_number"].holds
    coarse = dataclasses.replace(media["glass_beads"], grain=Quantity(0.03, "m", "chosen"))
    found, _ = moving(body(BOX), medium=coarse)
    assert found["inertial_number"].value == pytest.approx(
        0.5 / 0.06 * 0.03 / math.sqrt(9.81 * 0.08)
    )
    assert not found["inertial_number"].holds


def test_without_gravity_there_is_nothing_to_compare_with():
    found, report = moving(body(BOX, gravity=0.0))
    assert found["froude"].value == 0
    assert report.bodies[0].froude == 0
    assert found["inertial_number"].value is None
    assert found["inertial_number"].holds


def test_a_body_is_valid_within_all_limits():
    found, report = moving(body(BOX), velocity=(0, 0, -0.1))
    assert all(standing.holds for standing in found.values())
    assert report.bodies[0].valid
    found, report = moving(body(BOX), velocity=(0, 0, -0.1), height=-1.0)
    assert not found["depth_over_width"].holds
    assert not report.bodies[0].valid


def test_limits_of_resistive_force_theory_are_the_published():
    for name in ("rft2d", "rft3d"):
        most = {limit.measure: limit.most for limit in laws[name].validity}
        assert most["froude"] == 0.4
        assert most["inertial_number"] == 0.1
        assert most["slope"] <= math.radians(20)


@pytest.mark.parametrize("name", sorted(laws))
def test_every_limit_says_who_says_so(name):
    assert laws[name].validity
    for limit in laws[name].validity:
        assert limit.most > 0
        assert len(limit.source) > 10


@pytest.mark.parametrize(
    ("value", "holds"), [(None, True), (0.0, True), (0.4, True), (0.4000001, False)]
)
def test_standing(value, holds):
    assert Standing(Limit("froude", 0.4, "a source"), value).holds is holds


def test_limits_of_a_law_are_known():
    found, _ = moving(body(BOX))
    assert set(found) == {"froude", "inertial_number", "depth_over_width", "slope"}


# The error that travels with a force

SLOW, FAST, THIN = Finding(0.4, 8.0, 0.1, 3), Finding(2.0, 8.0, 0.2, 2), Finding(3.0, 3.0, 0.6, 1)


@pytest.mark.parametrize(
    ("froude", "grains", "finding"),
    [
        (0.0, 10.0, SLOW),
        (0.4, 8.0, SLOW),
        (0.41, 8.0, FAST),
        (0.41, None, FAST),  # no grain size is known
        (0.1, 4.0, THIN),  # nothing as thin was compared slowly
        (2.5, 100.0, THIN),
        (3.1, 100.0, None),
        (0.1, 2.0, None),
    ],
)
def test_the_finding_that_tells_most_of_a_motion(froude, grains, finding):
    assert found_at((THIN, FAST, SLOW), froude, grains) is finding


class Judged(DepthVelocityLaw):
    """A law about which something was found."""

    @property
    def findings(self):
        return SLOW, FAST


def test_a_report_has_the_error_that_was_found():
    # Of 5 cm: 0.7 m/s is a Froude number of 1.0.
    ball = body("<geom type='sphere' size='.025'/>")
    for speed, error in ((0.1, 0.1), (0.7, 0.2), (2.0, None)):
        _, report = moving(ball, velocity=(0, 0, -speed), law=Judged(constant=1.0))
        assert report.bodies[0].error == error
    _, report = moving(ball, height=0.5, law=Judged(constant=1.0))
    assert report.bodies[0].error is None  # above the sand


def test_a_law_without_limits_is_not_said_to_have_held():
    class Mud(DepthVelocityLaw):
        validity = ()

    ball = body("<geom type='sphere' size='.025'/>")
    for law, share in ((DepthVelocityLaw(constant=1.0), 1.0), (Mud(constant=1.0), None)):
        _, report = moving(ball, velocity=(0, 0, -0.1), law=law)
        assert BodySummary.of(report.bodies, 0.0, 0.0, 0.0).within_validity == share


def test_a_body_that_turns_in_the_sand_has_no_error():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body name="wheel" pos="0 0 .08">
      <joint axis="1 0 0" type="slide"/><joint axis="0 1 0"/>
      <geom type="cylinder" size=".1 .04" euler="90 0 0"/>
    </body></worldbody></mujoco>""")
    data, sand = mujoco.MjData(model), Sand(model)
    for turns, known in ((0.0, True), (1.0, False), (10.0, False)):
        data.qvel[:] = 0.1, turns
        assert (sand.report(data)["wheel"].error is not None) is known


@pytest.mark.parametrize("law", [GENERIC, dataclasses.replace(GENERIC, inertia=1.1, density=1500)])
def test_findings_are_those_of_the_published_table(law):
    assert law.findings
    file = Path(__file__).resolve().parents[2] / "docs" / "validity" / "reported_errors.csv"
    rows = file.read_text().splitlines()
    name = "rft2d inertia" if law.inertia else "rft2d"
    for finding in law.findings:
        numbers = f"{finding.froude:g},{finding.grains:g},{finding.error:g}"
        assert f"{name},{numbers},{finding.runs}" in rows
