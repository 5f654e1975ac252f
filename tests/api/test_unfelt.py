"""What can move and is not in the sand, or not as it moves: said once, with what would help."""

import warnings

import mujoco
import pytest

from mjgranular import DepthVelocityLaw, GranularWarning, InputError, Sand, add_sand
from mjgranular.cli.main import main
from mjgranular.errors import UnfeltWarning

BALL = '<body name="ball" pos="0 0 -.02"><freejoint/><geom size=".05"/></body>'
CLOTH = (
    '<flexcomp {name} type="grid" count="3 3 1" spacing=".1 .1 .1" pos="0 0 .3" radius=".01" '
    'dim="2" mass=".1"><edge equality="true"/>{pins}</flexcomp>'
)
NAMED = CLOTH.format(name='name="cloth"', pins="")
TOOL = '<body name="tool" mocap="true" pos="1 0 0"><geom size=".05"/>{more}</body>'


def text(*parts):
    return f"<mujoco><worldbody>{''.join(parts)}</worldbody></mujoco>"


def by_sand(xml, **options):
    Sand(mujoco.MjModel.from_xml_string(xml), **options)


def by_plugin(xml, **options):
    spec = mujoco.MjSpec.from_string(xml)
    add_sand(spec, **options)
    mujoco.MjData(spec.compile())


DOORS = pytest.mark.parametrize("door", [by_sand, by_plugin])


@DOORS
@pytest.mark.parametrize(
    ("part", "told"),
    [
        (NAMED, r"flex 'cloth': it feels geoms of rigid bodies alone.*bodies="),
        (TOOL.format(more=""), r"mocap body 'tool'.*free body and <weld>.*bodies="),
    ],
)
def test_what_moves_unfelt_is_named(door, part, told):
    with pytest.warns(UnfeltWarning, match=told) as caught:
        door(text(BALL, part))
    assert len({str(warning.message) for warning in caught}) == 1
    assert {warning.filename for warning in caught} == {__file__}


def test_a_flex_without_a_name_has_its_number():
    # A flexcomp has to have one; a flex in a file need not.
    vertices = "".join(
        f'<body name="v{i}" pos="{0.1 * i} 0 .5"><joint type="slide"/>'
        '<geom size=".01" contype="0" conaffinity="0"/></body>'
        for i in range(2)
    )
    flex = '<deformable><flex dim="1" body="v0 v1" element="0 1" radius=".01"/></deformable>'
    xml = text(BALL, vertices).replace("</mujoco>", flex + "</mujoco>")
    with pytest.warns(UnfeltWarning, match="on flex 0:"):
        by_sand(xml)


@DOORS
@pytest.mark.parametrize(
    ("parts", "options"),
    [
        ((NAMED,), {"bodies": "ball"}),
        ((TOOL.format(more=""),), {"bodies": ["ball"]}),
        ((TOOL.format(more=""),), {"groups": 0}),
        ((CLOTH.format(name='name="net"', pins='<pin id="0 1 2 3 4 5 6 7 8"/>'),), {}),
        ((TOOL.format(more="").replace("/>", ' contype="0" conaffinity="0"/>'),), {}),
    ],
)
def test_what_is_chosen_or_cannot_be_meant_is_not_told(door, parts, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error", GranularWarning)
        door(text(BALL, *parts), **options)


@pytest.mark.parametrize("options", [{"bodies": "all"}, {"bodies": ["all"]}, {"geoms": "all"}])
def test_all_is_no_choice(options):
    with pytest.warns(UnfeltWarning, match="flex 'cloth'"):
        by_sand(text(BALL, NAMED), **options)


def test_commands_say_so(tmp_path, capsys):
    path = tmp_path / "cloth.xml"
    path.write_text(text(BALL, NAMED))
    assert main(["drop", str(path), "--duration", "0.01", "--out", str(tmp_path / "out")]) == 0
    assert "flex 'cloth'" in " ".join(capsys.readouterr().err.split())


@DOORS
@pytest.mark.parametrize("options", [{"bodies": ["ball", "tool"]}, {"geoms": "t"}])
def test_a_mocap_body_that_is_named_is_refused_with_what_to_do(door, options):
    xml = text(BALL, TOOL.format(more="").replace("<geom", '<geom name="t"'))
    with pytest.raises(ValueError, match=r"body 'tool' is fixed .* to a mocap body.*<weld>"):
        door(xml, **options)


@pytest.mark.parametrize("bodies", ["cloth_4", ["ball", "cloth_4"], ["ball", "frame"]])
def test_a_body_without_a_collision_geom_that_is_named_is_refused(bodies):
    frame = '<body name="frame"><freejoint/><geom size=".1" contype="0" conaffinity="0"/></body>'
    with pytest.raises(InputError, match=r"has no collision geom .*geoms=\[\.\.\.\]"):
        by_sand(text(BALL, NAMED, frame), bodies=bodies)


WELDED = text(
    '<body name="hand" mocap="true" pos="0 0 -.02"/>',
    BALL.replace("<geom", '<geom name="tool" contype="0" conaffinity="2"'),
).replace("</mujoco>", '<equality><weld body1="hand" body2="ball"/></equality></mujoco>')


@pytest.mark.parametrize("speed", [0.05, 0.2])
def test_a_body_welded_to_a_mocap_body_meets_what_its_speed_asks_for(speed):
    model = mujoco.MjModel.from_xml_string(WELDED)
    law = DepthVelocityLaw(constant=0.3, stiffness=30.0, linear=0.1, quadratic=2.0)
    sand, data = Sand(model, law=law), mujoco.MjData(model)
    for i in range(500):
        data.mocap_pos[0, 0] = speed * model.opt.timestep * i
        sand.step(data)
    found = sand.report(data)["ball"]
    resists = 0.3 + 30.0 * found.depth + 0.1 * speed + 2.0 * speed**2
    assert found.force[0] == pytest.approx(-resists, rel=1e-3)
    assert data.qvel[0] == pytest.approx(speed, rel=1e-3)


def test_report_is_of_a_step_with_the_mocap_poses_of_that_step():
    model = mujoco.MjModel.from_xml_string(WELDED)
    model.eq_solref[0] = 0.004, 1
    sand, data = Sand(model), mujoco.MjData(model)
    for i in range(100):
        data.mocap_pos[0, 0] = 0.1 * model.opt.timestep * i
        sand.step(data)
    assert sand.report(data)["ball"].force[0] > 0.95 * data.efc_force[0]  # a hand that stops
    data.mocap_pos[0, 0] += 0.1 * model.opt.timestep
    assert sand.report(data)["ball"].force[0] == pytest.approx(data.efc_force[0], rel=1e-3)


@pytest.mark.parametrize("own", [False, True])
def test_touch_sensors_of_bodies_in_the_sand_are_told_to_be_numb(own):
    ball = BALL.replace("<geom", '<site name="sole" size=".1"/><geom')
    spec = mujoco.MjSpec.from_string(text(ball))
    spec.add_sensor(
        name="sole",
        type=mujoco.mjtSensor.mjSENS_TOUCH,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="sole",
    )
    if own:  # one that feels the sand is there too
        spec.activate_plugin("mjgranular.sensor")
        plugin = spec.add_plugin(name="felt", plugin_name="mjgranular.sensor", active=True)
        plugin.config = {"measure": "touch"}
        sensor = spec.add_sensor(
            name="felt",
            type=mujoco.mjtSensor.mjSENS_PLUGIN,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="sole",
        )
        sensor.plugin.active = True
        sensor.plugin.plugin_name, sensor.plugin.name = "mjgranular.sensor", "felt"
    add_sand(spec, law=DepthVelocityLaw(stiffness=30.0), scheme="explicit")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        mujoco.MjData(spec.compile())
    numb = [str(one.message) for one in said if "the sand (sole)" in str(one.message)]
    assert len(numb) == (0 if own else 1)  # once, though MuJoCo's compiler makes data of its own


@pytest.mark.parametrize(
    ("sensor", "is_named"),
    [
        ('contact geom1="ball"', True),
        ('contact body1="ball" body2="world"', True),
        ('contact subtree1="ball" geom2="floor"', True),
        ('contact site="sole"', True),
        ('contact geom1="ball" body2="peg"', False),  # of two bodies with each other
        ('contact body1="peg"', False),
    ],
)
def test_contact_sensors_do_not_measure_sand(sensor, is_named):
    ball = BALL.replace("<geom", '<site name="sole" size=".1"/><geom name="ball"')
    peg = '<body name="peg" pos="1 0 0"><freejoint/><geom size=".05"/></body>'
    floor = '<geom name="floor" type="plane" size="1 1 1" pos="0 0 -1"/>'
    xml = text(ball, peg, floor).replace("</mujoco>", f"<sensor><{sensor}/></sensor></mujoco>")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UnfeltWarning)
        by_sand(xml, bodies="ball")
    assert any("the sand (number 0)" in str(one.message) for one in said) == is_named
