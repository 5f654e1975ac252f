"""Slips of units are named, through every interface; what people really use is not."""

import math
import warnings

import mujoco
import pytest

from mjgranular import Plane, Rft3dLaw, Sand, add_sand, media
from mjgranular.cli import main
from mjgranular.errors import GranularWarning, RangeWarning

SLIP = Rft3dLaw(density=1.55, internal_friction=0.67, surface_friction=0.4)


def xml(timestep=2e-3, z=0.1):
    return (
        f'<mujoco><option timestep="{timestep}"/><worldbody><body pos="0 0 {z}"><freejoint/>'
        '<geom type="box" size=".1 .05 .03"/></body></worldbody></mujoco>'
    )


CASES = [
    (xml(), {"law": SLIP}, r"density of 1\.55 kg/m\^3.*1 g/cm\^3 is 1000 kg/m\^3"),
    (xml(timestep=1), {}, r"time step is 1 s.*1 ms is 0\.001 s"),
    (xml(z=-5), {}, r"starts 4.97 m and more under"),
    (xml().replace(".1 .05 .03", "100 50 30"), {}, r"geom .* is 232 m across.*232 mm is 0\.232 m"),
    # Of a size of its own: a sand that is prepared already is not judged again.
    (
        xml().replace("<option", '<option gravity="0 -9.81 0"').replace(".03", ".031"),
        {},
        r"90 degrees off the way into",
    ),
    # A part of a robot to be assembled, and an insect drawn in centimeters.
    (
        xml().replace("<option", '<option gravity="0 0 0"').replace(".03", ".032"),
        {},
        r"gravity is 0 m/s\^2",
    ),
    (
        xml().replace("<option", '<option gravity="0 0 -981"').replace(".03", ".033"),
        {},
        r"gravity is 981 m/s\^2",
    ),
    # A swimmer of Gymnasium or dm_control, and their fish.
    (
        xml().replace("<option", '<option density="4000"').replace(".03", ".034"),
        {},
        r"fluid of 4000",
    ),
    (
        xml()
        .replace("/><world", '><flag gravity="disable"/></option><world')
        .replace(".03", ".035"),
        {},
        r"gravity is 0 m/s\^2.* and no flag disables it",
    ),
    (xml(), {"surface": Plane(height=30)}, r"starts 29\.\d m and more under"),
]


@pytest.mark.parametrize(("text", "options", "said"), CASES)
def test_a_slip_is_named_in_python_and_in_mjcf(text, options, said):
    with pytest.warns(RangeWarning, match=said):
        Sand(mujoco.MjModel.from_xml_string(text), **options)
    spec = mujoco.MjSpec.from_string(text)
    add_sand(spec, **options)
    with pytest.warns(RangeWarning, match=said):
        mujoco.MjData(spec.compile())


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        (xml(timestep=1), ["--timestep", "0.5"], "0.5 ms is 0.0005 s"),
        (xml(z=-5), [], "starts 4.97"),
        (xml(), ["--surface-height", "30"], "lengths are in"),
    ],
)
def test_a_slip_is_named_on_the_command_line(tmp_path, capsys, text, options, said):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    main(["drop", str(path), *options, "--duration", "0.01"])
    assert said in " ".join(capsys.readouterr().err.split())


def test_what_people_use_is_no_slip():
    model = mujoco.MjModel.from_xml_string(xml(timestep=0.02, z=-0.5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in media:
            if name != "play_sand":
                Sand(model, medium=name)
        Sand(model, surface=Plane(height=0.4))
        model.opt.density = 1025.0  # on the bed of the sea
        Sand(model)


def robot(z, joint="<freejoint/>"):
    return (
        f'<mujoco><worldbody><body name="bot" pos="0 0 {z}" euler="90 0 0">{joint}'
        '<geom type="box" size=".1 .05 .1"/><body pos=".15 0 0"><joint axis="0 0 1"/>'
        '<geom type="capsule" fromto="0 0 0 0 -.15 0" size=".02"/></body></body></worldbody>'
        "</mujoco>"
    )


def test_a_robot_that_starts_buried_is_told_once():
    model = mujoco.MjModel.from_xml_string(robot(-0.3))
    with pytest.warns(GranularWarning, match=r"'bot' is buried 0\.25 m.*raise it") as told:
        sand = Sand(model)
    assert len(told) == 1
    spec = mujoco.MjSpec.from_string(robot(-0.3))
    add_sand(spec)
    with pytest.warns(GranularWarning, match="'bot' is buried"):
        mujoco.MjData(spec.compile())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    with pytest.warns(
        GranularWarning, match="buried 0.25 m and more under the sand, in this MjData"
    ):
        sand.check(data)
    data.qpos[2] = 0.3
    mujoco.mj_kinematics(model, data)
    sand.check(data)
    level = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 0 1"))
    Sand(mujoco.MjModel.from_xml_string(robot(-0.3, level)))  # swims in its plane
    Sand(mujoco.MjModel.from_xml_string(robot(-0.12)))  # no deeper than its own size


@pytest.mark.parametrize(("degrees", "memory"), [(36, None), (86, None), (-86, None), (33, True)])
def test_a_slope_above_the_angle_of_repose_is_told(degrees, memory):
    model, repose = mujoco.MjModel.from_xml_string(xml()), 32 if memory else 34
    said = f"slopes by {abs(degrees)} degrees, and its angle of repose is {repose}:"
    with pytest.warns(RangeWarning, match=said):
        Sand(model, surface=Plane(slope=math.radians(degrees)), memory=memory)


def test_a_slope_at_the_angle_of_repose_is_none_to_warn_of():
    model = mujoco.MjModel.from_xml_string(xml())
    Sand(model, surface=Plane(slope=math.radians(34)))
    Sand(model, surface=Plane(slope=math.radians(32)), memory=True)
    model.opt.gravity[:] = -9.81 * Plane(slope=1.0).normal  # along the normal: level ground
    Sand(model, surface=Plane(slope=1.0))
