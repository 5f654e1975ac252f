"""Ground of the model's own that carries bodies before they meet the sand."""

import json
import warnings

import mujoco
import pytest

from mjgranular import Bed, GranularWarning, HeightField, InputError, Plane, Sand, add_sand
from mjgranular.cli import main
from mjgranular.cli.view import ViewCommand
from mjgranular.errors import FloorWarning
from mjgranular.shape import select_geoms
from mjgranular.surface.floors import FloorWatch, find_floors

SAND = {"medium": "quikrete_medium"}
BALL = '<body name="ball" pos="{x} 0 0.5"><freejoint/><geom name="ball" size="0.1"/></body>'


def world(ground, x=0.0, assets=""):
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{ground}{BALL.format(x=x)}</worldbody></mujoco>"
    )


def floors(model, surface):
    geoms = select_geoms(model, leave_out=surface.geoms(model))
    return [model.geom(geom).name for geom in find_floors(model, geoms, surface)]


FIELD = '<hfield name="f" nrow="3" ncol="3" size="1 1 0.1 0.1" elevation="0 0 0 0 1 0 0 0 0"/>'


def geom(kind, name="floor", **attributes):
    return (
        f'<geom name="{name}" type="{kind}"'
        + "".join(f' {key}="{value}"' for key, value in {"size": "1 1 0.1", **attributes}.items())
        + "/>"
    )


def hfield(name):
    return f'<geom name="{name}" type="hfield" hfield="f"/>'


BED = geom("box", "bed", pos="0 0 0.1")
CASES = {
    "plane at the surface": (geom("plane"), Plane(), True),
    "plane above it": (geom("plane"), Plane(-0.2), True),
    "plane below it": (geom("plane"), Plane(0.2), False),
    "to be seen only": (geom("plane", contype=0, conaffinity=0), Plane(), False),
    "box at the surface": (geom("box", pos="0 0 -0.1"), Plane(), True),
    "box below it": (geom("box", pos="0 0 -0.3"), Plane(), False),
    "box elsewhere": (geom("box", pos="5 0 0"), Plane(), False),
    "hfield above it": (hfield("floor"), Plane(), True),
    "floor of a bed": (geom("plane") + BED, Bed("bed"), False),
    "floor over a bed": (geom("plane", pos="0 0 0.3") + BED, Bed("bed"), True),
    "floor beside a bed": (geom("plane") + geom("box", "bed", pos="5 0 0.1"), Bed("bed"), False),
    "floor of a field": (geom("plane") + hfield("field"), HeightField("field"), False),
    "wall beside it": (geom("box", size="0.1 1 1", pos="0.5 0 0"), Plane(), False),
    "on another body of the world": (f"<body>{geom('box')}</body>", Plane(), True),
    "on a slope": (geom("plane", euler="0 -20 0"), Plane(slope=0.349), True),
}


@pytest.mark.parametrize("case", CASES)
def test_what_carries_is_found(case):
    ground, surface, carries = CASES[case]
    assert floors(world(ground, assets=FIELD), surface) == (["floor"] if carries else [])


def test_the_base_of_an_arm_does_not_carry_its_links():
    """This was an error of `drop` for every arm, with the advice to switch its base off."""
    link = '<body pos="0 0 0.2"><joint/><geom type="capsule" size="0.03 0.1"/></body>'
    arm = f"<body>{geom('box', 'foot')}<body>{geom('box', 'torso')}{link}</body></body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{arm}</worldbody></mujoco>")
    assert floors(model, Plane()) == []
    data, watch = mujoco.MjData(model), FloorWatch(model, [model.ngeom - 1], Plane())
    mujoco.mj_forward(model, data)
    assert data.ncon
    watch.look(data)
    assert not watch.floors


def test_down_is_where_gravity_pulls():
    turned = f'<body quat="1 1 0 0">{geom("plane", pos="0 0 0.3")}{BED}</body>'
    ball = BALL.format(x=0).replace("0 0 0.5", "0 -0.39 0")
    xml = f'<mujoco><option gravity="0 9.81 0"/><worldbody>{turned}{ball}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    assert floors(model, Bed("bed")) == ["floor"]
    data, watch = mujoco.MjData(model), FloorWatch(model, [model.ngeom - 1], Bed("bed"))
    mujoco.mj_forward(model, data)
    watch.look(data)
    assert watch.floors == {model.geom("floor").id}


@pytest.mark.parametrize("z", [0.0, -0.05, -0.09])
@pytest.mark.parametrize("ground", [geom("plane"), geom("box", pos="0 0 -0.1")])
def test_a_body_that_begins_within_its_floor(ground, z):
    xml = f"<mujoco><worldbody>{ground}{BALL.format(x=0)}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(xml.replace("0 0 0.5", f"0 0 {z}"))
    assert floors(model, Plane()) == ["floor"]


def test_pairs_collide_whatever_the_masks_say():
    xml = """
    <mujoco>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 1" contype="0" conaffinity="0"/>
        <body pos="0 0 0.5"><freejoint/><geom name="ball" size="0.1"/></body>
      </worldbody>
      <contact><pair geom1="floor" geom2="ball"/></contact>
    </mujoco>
    """
    assert floors(mujoco.MjModel.from_xml_string(xml), Plane()) == ["floor"]


def test_nothing_is_changed_in_the_model():
    model = world(geom("box", pos="0 0 -0.1"))
    before = model.geom_group.tobytes(), model.geom_rgba.tobytes()
    floors(model, Plane())
    assert (model.geom_group.tobytes(), model.geom_rgba.tobytes()) == before


def test_both_interfaces_warn():
    bodies = geom("plane", "ground") + BALL.format(x=0)
    xml = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    with pytest.warns(GranularWarning, match=r"'ground' \(a plane\) would carry it"):
        Sand(mujoco.MjModel.from_xml_string(xml), **SAND)
    spec = mujoco.MjSpec.from_string(xml)
    add_sand(spec, **SAND)
    with pytest.warns(GranularWarning, match=r"'ground' \(a plane\) would carry it"):
        spec.compile()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Sand(mujoco.MjModel.from_xml_string(xml), surface=Plane(0.2), **SAND)


ROBOT = f"""
<mujoco>
  <worldbody>
    {geom("plane")}<geom type="box" size="1 1 0.1" pos="0 0 -0.05"/>
    <body pos="0 0 0.2"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_drop_refuses_ground_of_the_models_own(tmp_path, capsys):
    model = tmp_path / "robot.xml"
    model.write_text(ROBOT)
    assert main(["drop", str(model), "--duration", "0.1"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "'floor' (a plane)" in said
    assert "--instead-of floor 1, or say --keep-floor" in said  # one has no name
    out = ["--instead-of", "floor", "1", "--duration", "0.5", "--json"]
    assert main(["drop", str(model), *out]) == 0
    sunk = json.loads(capsys.readouterr().out)["bodies"][0]["greatest_depth"]
    assert main(["drop", str(model), "--keep-floor", "--duration", "0.5", "--json"]) == 0
    kept = json.loads(capsys.readouterr().out)["bodies"][0]["greatest_depth"]
    assert kept < 0.005 < 0.02 < sunk


def test_a_geom_to_take_out_that_is_not_there(tmp_path, capsys):
    model = tmp_path / "robot.xml"
    model.write_text(ROBOT)
    assert main(["drop", str(model), "--instead-of", "flor"]) == 2
    assert "no geom of the model 'flor'; there are: floor" in " ".join(
        capsys.readouterr().err.split()
    )


def test_view_refuses_it_too(tmp_path):
    model = tmp_path / "robot.xml"
    model.write_text(ROBOT)
    with pytest.raises(InputError, match="--instead-of floor"):
        ViewCommand(model=model).load()
    loaded = ViewCommand(model=model, instead_of=("floor", "1")).load()
    names = [loaded.geom(number).name for number in range(loaded.ngeom)]
    assert names == ["floor", "", ""]
    assert not (loaded.geom_contype | loaded.geom_conaffinity)[:2].any()
    assert loaded.geom_group[:2].tolist() == [5, 5]  # not shown


LOW = geom("plane", pos="0 0 -0.01")  # beneath the sand, and above the depth that the ball comes to


def test_ground_just_beneath_the_sand_is_told_once_it_carries():
    model = world(LOW)
    sand = Sand(model, **SAND)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.105
    sand.check(data)  # above it
    while data.time < 0.5:
        sand.step(data)
    with pytest.warns(FloorWarning, match=r"'floor' \(a plane\) carries it"):
        sand.check(data)
    replaced = Sand(world(LOW), instead_of=["floor"], **SAND)
    data = mujoco.MjData(replaced.model)
    while data.time < 0.5:
        replaced.step(data)
    replaced.check(data)


def test_drop_says_that_ground_beneath_the_sand_has_carried(tmp_path, capfd):
    path = tmp_path / "low.xml"
    path.write_text(f"<mujoco><worldbody>{LOW}{BALL.format(x=0)}</worldbody></mujoco>")
    command = ["drop", str(path), "--height", "0.02", "--duration", "0.3"]
    told = "'floor' (a plane) carries it beside or beneath the sand"
    assert main(command) == 0
    assert told in capfd.readouterr().err.replace("\n", " ")
    for options in (["--keep-floor"], ["--instead-of", "floor"]):
        assert main([*command, *options]) == 0
        assert told not in capfd.readouterr().err.replace("\n", " ")


def test_walls_that_bodies_lean_on_do_not_carry():
    wall = geom("box", "wall", size="0.1 1 1", pos="0.19 0 0")
    model = world(wall)
    sand = Sand(model, **SAND)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.1
    sand.step(data)
    assert data.ncon > 0
    sand.check(data)
