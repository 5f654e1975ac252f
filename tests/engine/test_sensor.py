"""Sensors of the sand, and what it draws."""

from __future__ import annotations

import copy
import re

import mujoco
import numpy as np
import pytest

from mjgranular import Sand
from mjgranular.engine import add_sand

SENSORS = """
<mujoco>
  <option timestep="1e-4"/>
  <extension>
    <plugin plugin="mjgranular.sand">
      <instance name="sand">
        <config key="law" value="link_distributed"/>
        <config key="scheme" value="explicit half_step=false"/>
        <config key="draw" value="{draw}"/>
      </instance>
    </plugin>
    <plugin plugin="mjgranular.sensor"/>
  </extension>
  <worldbody>
    <body name="a" pos="0 0 -0.05" euler="0 80 0">
      <freejoint/><geom type="capsule" size="0.01 0.1"/>
      <body name="b" pos="0 0 0.2">
        <joint axis="0 1 0"/><geom type="capsule" size="0.01 0.1"/>
      </body>
    </body>
    <body name="stone" pos="1 0 1"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <sensor>
    <clock/>
    <plugin name="force" plugin="mjgranular.sensor" objtype="body" objname="b">
      <config key="measure" value="force"/>
    </plugin>
    <plugin name="moment" plugin="mjgranular.sensor" objtype="body" objname="a">
      <config key="measure" value="moment"/>
    </plugin>
    <plugin name="power" plugin="mjgranular.sensor"><config key="measure" value="power"/></plugin>
    <plugin name="depth" plugin="mjgranular.sensor" objtype="body" objname="b">
      <config key="measure" value="depth"/><config key="sand" value="sand"/>
    </plugin>
    <plugin name="speed" plugin="mjgranular.sensor"><config key="measure" value="speed"/></plugin>
    <plugin name="whole" plugin="mjgranular.sensor"><config key="measure" value="force"/></plugin>
  </sensor>
</mujoco>
"""
PLAIN = re.sub(r"(?s)<(extension|sensor)>.*?</\1>", "", SENSORS)  # without sand


def moving(draw: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(SENSORS.format(draw=draw))
    data = mujoco.MjData(model)
    data.qvel[:7] = 0.3, -0.1, -0.5, 1.0, 2.0, -1.0, 3.0
    return model, data


def test_sensors_say_what_the_report_says() -> None:
    model, data = moving()
    mujoco.mj_step(model, data, 10)
    plain = mujoco.MjModel.from_xml_string(PLAIN)
    there = mujoco.MjData(plain)
    there.qpos[:], there.qvel[:] = data.qpos, data.qvel
    sand = Sand(plain, law="link_distributed", bodies=["a", "b"], scheme="explicit")
    report = sand.report(there)
    mujoco.mj_forward(model, data)
    readings = {name: data.sensor(name).data for name in ("force", "moment", "power", "depth")}
    assert readings["depth"] == pytest.approx(report["b"].depth, rel=1e-12)
    assert readings["force"] == pytest.approx(report["b"].force, rel=1e-9)
    assert readings["moment"] == pytest.approx(report["a"].moment, rel=1e-9)
    power = sum(body.power for body in report.bodies)
    assert power < 0
    assert readings["power"] == pytest.approx(power, rel=1e-9)
    immersed = report.elements.depth > 0
    fastest = np.linalg.norm(report.elements.velocity[immersed], axis=1).max()
    assert data.sensor("speed").data == pytest.approx(fastest, rel=1e-9)
    total = sum(body.force for body in report.bodies)
    assert data.sensor("whole").data == pytest.approx(total, rel=1e-9)
    assert data.qfrc_passive[:3] == pytest.approx(data.sensor("whole").data, rel=1e-12)


def test_sensors_write_where_they_are_read() -> None:
    # An empty array of MuJoCo's lies where the next begins, one that is not empty does not.
    sized = SENSORS.replace("<option", '<size nuserdata="2" nuser_sensor="1"/><option')
    model = mujoco.MjModel.from_xml_string(sized.format(draw=""))
    data = mujoco.MjData(model)
    data.userdata[:] = 3.0, 4.0
    mujoco.mj_step(model, data, 10)
    assert list(data.userdata) == [3.0, 4.0]
    plain, other = moving()
    other.qvel[:] = 0.0
    mujoco.mj_step(plain, other, 10)
    np.testing.assert_array_equal(data.sensordata, other.sensordata)


def test_sensors_in_copies_and_batches() -> None:
    model, data = moving()
    mujoco.mj_step(model, data, 10)
    twin = copy.copy(data)
    np.testing.assert_array_equal(twin.sensordata, data.sensordata)
    mujoco.mj_step(model, twin)
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(twin.sensordata, data.sensordata)
    batch = pytest.importorskip("mujoco.batch").Batch(model, 3, 2)
    batch.reset()
    batch.qvel[:, :7] = 0.3, -0.1, -0.5, 1.0, 2.0, -1.0, 3.0
    readings = batch.bind("sensordata")
    batch.step(nstep=11)
    np.testing.assert_array_equal(readings, np.tile(data.sensordata, (3, 1)))


SLEEPERS = """
<mujoco>
  <option><flag sleep="enable"/></option>
  <extension>
    <plugin plugin="mjgranular.sand"><instance name="sand"/></plugin>
    <plugin plugin="mjgranular.sensor"/>
  </extension>
  <worldbody>
    <body name="a" pos="0 0 0.05"><freejoint/><geom name="a" size="0.05" mass="0.2"/></body>
  </worldbody>
  <sensor>
    <plugin name="force" plugin="mjgranular.sensor" objtype="body" objname="a">
      <config key="measure" value="force"/>
    </plugin>
    <plugin name="touch" plugin="mjgranular.sensor" objtype="geom" objname="a">
      <config key="measure" value="touch"/>
    </plugin>
  </sensor>
</mujoco>
"""


@pytest.mark.skipif(not hasattr(mujoco, "mjtSleepState"), reason="in this MuJoCo nothing sleeps")
def test_what_sleeps_keeps_its_readings() -> None:
    model = mujoco.MjModel.from_xml_string(SLEEPERS)
    data = mujoco.MjData(model)
    names, readings = ("force", "touch"), []
    while data.body_awake[1] != int(mujoco.mjtSleepState.mjS_ASLEEP) and data.time < 4:
        readings = [data.sensor(name).data.copy() for name in names]
        mujoco.mj_step(model, data)
    mujoco.mj_step(model, data, 200)
    assert data.body_awake[1] == int(mujoco.mjtSleepState.mjS_ASLEEP)
    for name, reading in zip(names, readings, strict=True):
        assert data.sensor(name).data == pytest.approx(reading, abs=1e-6)
    assert data.sensor("force").data[2] == pytest.approx(0.2 * 9.81, rel=1e-6)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('value="moment"', 'value="torque"', "no measure 'torque'; there are: force, moment"),
        ('key="sand" value="sand"', 'key="sand" value="mud"', "no sand in the model 'mud'"),
        ('objtype="body" objname="b"', 'objtype="body" objname="stone"', "those that do: a, b"),
        ('objtype="body" objname="a"', "", "a moment is about"),
        ('objname="b"', 'objname="b" reftype="body" refname="a"', "world axes: omit reftype"),
        ('objtype="body" objname="b"', 'objtype="geom" objname="g"', "objtype must be body"),
    ],
)
def test_a_mistake_in_a_sensor_is_a_load_error(before: str, after: str, said: str) -> None:
    text = SENSORS.format(draw="").replace('size="0.1" contype', 'name="g" size="0.1" contype')
    assert before in text
    with pytest.raises(ValueError, match="engine error") as caught:
        mujoco.MjModel.from_xml_string(text.replace(before, after, 1))
    assert said in str(caught.value)


def drawn(model: mujoco.MjModel, data: mujoco.MjData, room: int = 200) -> list[mujoco.MjvGeom]:
    """Geoms of a scene that the plugin has added: decoration that is none of MuJoCo's."""
    scene, option = mujoco.MjvScene(model, room), mujoco.MjvOption()
    camera = mujoco.MjvCamera()
    mujoco.mjv_updateScene(
        model, data, option, mujoco.MjvPerturb(), camera, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    assert scene.ngeom <= room
    decor = int(mujoco.mjtCatBit.mjCAT_DECOR)
    return [geom for geom in scene.geoms[: scene.ngeom] if geom.category == decor]


def test_nothing_is_drawn_unless_asked_for() -> None:
    model, data = moving()
    mujoco.mj_step(model, data, 10)
    assert not drawn(model, data)


def test_arrows_and_dots_are_drawn() -> None:
    model, data = moving("forces depth")
    mujoco.mj_step(model, data, 10)
    geoms = drawn(model, data)
    arrows = [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_ARROW]
    dots = [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE]
    assert len(arrows) == 2  # one a body
    assert len(dots) > 3
    assert len(arrows) + len(dots) == len(geoms)
    deepest = min(dots, key=lambda dot: dot.pos[2])
    assert deepest.rgba == pytest.approx([0, 0, 1, 1])
    force = data.sensor("force").data
    assert arrows[1].mat[:, 2] == pytest.approx(force / np.linalg.norm(force), abs=1e-6)
    assert len(drawn(model, data, room=3)) <= 3


def test_arrows_have_the_scale_that_the_model_has_now() -> None:
    model, data = moving("forces")
    mujoco.mj_step(model, data, 10)
    sizes = []
    for model.vis.map.force, model.stat.meansize in ((0.1, 0.05), (0.3, 0.1)):
        sizes.append(drawn(model, data)[1].size.copy())
    assert sizes[1] == pytest.approx(sizes[0] * [2, 2, 3])


def test_a_copy_draws_what_the_original_did() -> None:
    model, data = moving("forces")
    mujoco.mj_step(model, data, 10)
    assert len(drawn(model, copy.copy(data))) == len(drawn(model, data)) == 2


def test_the_renderer_draws() -> None:
    model, data = moving("forces depth")
    mujoco.mj_step(model, data, 10)
    try:
        renderer = mujoco.Renderer(model, 60, 80)
    except Exception as error:
        pytest.skip(f"no renderer: {error}")
    with renderer:
        renderer.update_scene(data)
        assert renderer.render().std() > 0


def test_add_sand_writes_what_is_drawn() -> None:
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    instance = add_sand(spec, medium="quikrete_medium", draw="forces")
    assert instance.config["draw"] == "forces"
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[2] = -0.1
    mujoco.mj_step(model, data)
    assert drawn(model, data)
