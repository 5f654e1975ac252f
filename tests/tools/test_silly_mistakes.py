"""Silly mistakes on the command line, drawn up from the documents alone: one sentence each."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from mjgranular.cli import main
from mjgranular.cli.options import parse_integer

BLOCK = """
<mujoco model="block">
  <worldbody>
    <body name="block" pos="0 0 0.2" euler="0 20 0">
      <freejoint/>
      <geom name="block" type="box" size="0.05 0.03 0.02" density="2000"/>
    </body>
  </worldbody>
</mujoco>
"""
FLOOR = '<geom name="floor" type="plane" size="1 1 .1"/>'
MEDIUM = """\
name: mine
title: Mine
density: {value: 1500, unit: kg/m^3, source: weighed}
default_law: rft3d
constants:
  rft3d:
    scale: {value: 1.0, source: guessed}
"""
QUAD = "import gymnasium\ngymnasium.register('Quad-v0', entry_point='CartPole-v1')\n"
FILES = {
    "block.xml": BLOCK,
    "floor.xml": BLOCK.replace("<worldbody>", f"<worldbody>{FLOOR}"),
    "fixed.xml": BLOCK.replace("<freejoint/>", ""),
    "hinged.xml": BLOCK.replace("<freejoint/>", "<joint type='hinge'/>"),
    "nobody.xml": "<mujoco/>",
    "broken.xml": BLOCK[:150],
    "empty.xml": "",
    "urdf.xml": "<robot name='r'><link name='l'/></robot>",
    "shape.xml": BLOCK.replace('type="box"', 'type="cube"'),
    "mesh.xml": BLOCK.replace(
        "<worldbody>", "<asset><mesh name='m' file='leg.stl'/></asset><worldbody>"
    ),
    "sand.xml": BLOCK.replace(
        "<worldbody>",
        "<extension><plugin plugin='mjgranular.sand'><instance name='s'>"
        "<config key='law' value='rft3d scael=2'/></instance></plugin></extension><worldbody>",
    ),
    "notes.txt": "my notes",
    "mine.yaml": MEDIUM,
    "typo.yaml": MEDIUM.replace("scale", "scael"),
    "law.yaml": MEDIUM.replace("rft3d", "rtf3d"),
    "unit.yaml": MEDIUM.replace("value: 1500", "value: 1,5"),
    "list.yaml": "- a\n- b\n",
    "bad.toml": "algorithm = ppo\n",
    "quad.py": QUAD,
    "error.py": "import gymnasium\n1 / 0\n",
    "old/summary.json": "{}",
    "old/config.json": "{}",
}

# What is typed behind `mjgranular`, and words of what is said.
MISTAKES = """
drop | Missing from mjgranular drop: MODEL.xml
drop blok.xml | MuJoCo cannot load blok.xml
drop '' | cannot read the model .: it is a folder
drop . | cannot read the model .: it is a folder
drop notes.txt | cannot read the model notes.txt: use MJCF or URDF
drop broken.xml | MuJoCo cannot load broken.xml
drop empty.xml | MuJoCo cannot load empty.xml
drop urdf.xml | no geom of the model can meet the sand: a body with a joint and a collision geom
drop shape.xml | MuJoCo cannot load shape.xml
drop mesh.xml | MuJoCo cannot load mesh.xml
drop nobody.xml | no geom of the model can meet the sand: a body with a joint and a collision geom
drop fixed.xml | no geom of the model can meet the sand: a body with a joint and a collision geom
drop floor.xml | the model's own geom 'floor'
drop sand.xml | config 'law': the law 'rft3d' has no option 'scael'
drop mine.yaml | cannot read the model mine.yaml: use MJCF or URDF
drop block.xml --height -0.1 | height must be finite and not negative
drop block.xml --height nan | height must be finite and not negative
drop block.xml --height 10cm | a number without its unit ... '10cm'
drop hinged.xml --height 1 | no free joint (in URDF: floating) and no vertical slide
drop hinged.xml --velocity 1 | no free joint (in URDF: floating) and no vertical slide
drop block.xml --velocity inf | the velocity must be finite
drop block.xml --duration 0 | the duration must be positive and finite
drop block.xml --duration inf | the duration must be positive and finite
drop block.xml --timestep 0 | the time step must be positive and finite
drop block.xml --timestep -0.001 | the time step must be positive and finite
drop block.xml --slope 90 | the plane's slope must be less than 90 degrees
drop block.xml --slope nan | the plane's slope must be finite
drop block.xml --medium sand | no medium 'sand' ... did you mean yuma_sand?
drop block.xml --medium '' | no medium ''; there are: glass_beads, glass_beads_3mm_close,
drop block.xml --medium Play_Sand | no medium 'Play_Sand' ... did you mean play_sand?
drop block.xml --medium my_sand.yaml | cannot read the medium my_sand.yaml
drop block.xml --medium notes.txt | no medium 'notes.txt'; there are: glass_beads, glass
drop block.xml --medium list.yaml | list.yaml: a medium must be a mapping with name
drop block.xml --medium unit.yaml | unit.yaml: medium 'mine': the bulk density must be from 10 to
drop block.xml --medium typo.yaml | medium 'mine': the law 'rft3d' has no constant 'scael'
drop block.xml --medium law.yaml | no law 'rtf3d' ... did you mean rft3d?
drop block.xml --medium play_sand | geom 'block' is a box: the link law acts on slender bodies
drop block.xml --law rft | no law 'rft'; there are: depth_velocity, link, ... did you mean rft3d?
drop block.xml --law '' | no law ''; there are: depth_velocity, link,
drop block.xml --law 'rft3d scael=1.3' | the law 'rft3d' has no option 'scael'
drop block.xml --law 'rft3d scale' | the option 'scale' of the law 'rft3d' needs a value: scale=...
drop block.xml --law 'rft3d scale=big' | scale must be a number, not
drop block.xml --law 'rft3d scale=-1' | Rft3dLaw: scale must be finite and not negative
drop block.xml --law 'rft3d scale=nan' | Rft3dLaw: scale must be finite and not negative
drop block.xml --law 'rft3d scale=1 scale=2' | the option 'scale' of the law 'rft3d' is given twice
drop block.xml --law "rft3d 'scale=1" | "rft3d 'scale=1" cannot be split into words: no closing
drop block.xml --law my_laws:Drag | no module 'my_laws'; there are: error, quad (for the law
drop block.xml --scheme rk4 | no scheme 'rk4'; there are: auto, explicit,
drop block.xml --scheme 'implicit tolerance=0' | the scheme 'implicit' has no option 'tolerance'
drop block.xml --bodies blok | no body of the model 'blok' ... did you mean block?
drop block.xml --bodies '' | no body of the model ''; there are: world,
drop block.xml --bodies world | body 'world' is fixed to the world
drop block.xml --geoms 99 | the model has no geom number 99: they go from 0 to 0
drop block.xml --groups 7 | no geoms of bodies that can move in geom group 7; there are: 0
drop block.xml --resolution 0 | the resolution must be at least 2
drop block.xml --resolution fine | integer ... 'fine'
drop block.xml --bed block | geom 'block' is on body 'block'
drop block.xml --bed tray | no box geom of the model 'tray'
drop block.xml --bed tray --height-field dune | the sand is either a bed or a height field
drop block.xml --height-field block | geom 'block' is a box: a height field is made of a hfield geom
drop block.xml --keyframe stand | no keyframe of the model 'stand'
drop block.xml --instead-of floor | no geom of the model 'floor'
drop block.xml --bed tray --slope 10 | --slope is for a plane
drop block.xml --uphill 90 | --uphill is the direction of a slope: add --slope
drop block.xml --law link --medium play_sand | choose them with --geoms NAME or --bodies NAME
drop block.xml --memory 'yes please' | memory, the side of a cell, must be a number
drop block.xml --video | --video needs a folder to write to: add --out DIR
drop block.xml --out old | old holds a result already (config.json, summary.json):
drop block.xml --out notes.txt | cannot write to notes.txt: File exists; choose a writable folder
drop block.xml --out /proc/nowhere | cannot write to /proc/nowhere
drop block.xml --out results --video --camera up | no camera 'up'; there are:
drop block.xml --hieght 0.1 | Unrecognized options: --hieght
dorp block.xml | no command 'dorp'; there are: impact, ... did you mean drop?
drop block.xml floor.xml | Unrecognized options: floor.xml
view block.xml --speed 0 | the speed must be positive and finite
view block.xml --draw arrows | invalid choice 'arrows' for argument '--draw'. Expected one of
elements block.xml --figure block.bmp | a figure is written as .png, .svg or .pdf, not
elements block.xml --figure old | a figure is written as .png, .svg or .pdf, not
elements block.xml --law link --medium glass_beads | no constants in medium 'glass_beads' for law
impact --speed -1 | the downward speed of T must not be negative
impact --angle 90 | the angle from the vertical must be less than 90 degrees
impact --body cube | invalid choice 'cube' for argument '--body'. Expected one of
impact --body sphere --length 0.3 | a sphere has no --length: its size is its --diameter
impact --camera close | --camera is for a film: add --video
impact --until never | invalid choice 'never' for argument '--until'. Expected one of
impact --length 20 --diameter 30 | the link must be longer than it is thick: length 20.0 m
impact --density 0 | the link's density must be positive and finite
intrude --intruder cube | invalid choice 'cube' for argument '--intruder'. Expected one of
intrude --depth -0.1 | the path never gets from 0.0 m to -0.1 m: it goes down
intrude --points 1 | points must be at least 2
intrude --points 99999999999 | points must be at most 100000
intrude --size 0 | the size must be positive and finite
intrude --geom foot | --geom ... give the model too
intrude --model block.xml --geom foot | no geom of the model 'foot'; there are:
intrude --model floor.xml --geom floor | geom 'floor' is fixed to the world
intrude --model block.xml --intruder sphere | the intruder is a shape or of a model: omit --model
sweep --vary mass=1,2 | no field to vary 'mass'; there are:
sweep --vary speed=2:2:3 | speed=2:2:3: both ends must be finite, and differ
sweep --vary speed=1:2:1 | 2 to 1000000 values
render nowhere | nowhere holds no saved run (nowhere/config.json cannot be
render old | old holds no saved run (config.json
render notes.txt | notes.txt holds no saved run
render old --out film.avi | old holds no saved run (config.json
render Hexapod-v0/ppo-0 | a film of Hexapod-v0/ppo-0 needs a file to write to: add --out FILE
render Hexapod-v0/ppo-0 --out film.mp4 --fps 0 | a video has 1 to 240 frames a second
render Hexapod-v0/ppo-0 --out film.mp4 --seed -1 | seed must be at least 0, not -1
render mjgranular/Hexapod-v0 | mjgranular/Hexapod-v0 is an environment ... a film is made of a run
list media moon | no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,
list media '' | no medium ''; there are: glass_beads, glass_beads_3mm_close,
list media . | no medium '.'; there are: glass_beads, glass_beads_3mm_close,
list media moon.yaml | cannot read the medium moon.yaml
list media typo.yaml | medium 'mine': the law 'rft3d' has no constant 'scael'
list media law.yaml | no law 'rtf3d'; there are: depth_velocity, link, ... did you mean rft3d?
list laws rtf3d | no law 'rtf3d'; there are: depth_velocity, link, ... did you mean rft3d?
list envs ChainSwin | no environment 'ChainSwin' ... did you mean mjgranular/ChainSwim-v0?
train | train needs an environment, for example mjgranular train
train '' | no environment ''; there are: mjgranular/Ant-v0,
train Hexapod | no environment 'Hexapod' ... did you mean mjgranular/Hexapod-v0?
train mjgranular/Hexpod-v0 | no environment 'mjgranular/Hexpod-v0' ... did you mean
train CartPole | no environment 'CartPole' ... did you mean CartPole-v1
train quad | no environment 'quad'; there are: mjgranular/Ant-v0,
train quad.py | no environment 'quad.py'; there are: mjgranular/Ant-v0,
train quad: | 'quad:' lacks the id behind the colon: quad:My-v0
train :Quad-v0 | the module '' of the environment :Quad-v0 cannot be imported: name it as
train quad:Quadd-v0 | no environment 'quad:Quadd-v0' ... did you mean Quad-v0
train quad:Nope-v0 | no environment 'quad:Nope-v0' ... importing quad has registered no Nope-v0
train qaud:Quad-v0 | no module 'qaud'; there are: error, quad ... did you mean quad?
train error:Quad-v0 | the module 'error' of the environment error:Quad-v0 cannot be imported
train CartPole-v1 --algorithm dqn | no algorithm 'dqn'; there are: ppo, sac,
train mjgranular/LinkDrop-v0 --algorithm dqn | no algorithm 'dqn'; there are: ppo, sac, td3
train CartPole-v1 --total-steps 0 | total_steps must be ... 0
train CartPole-v1 --total-steps 1.5 | integer ... '1.5'
train CartPole-v1 --seed -1 | seed must be ... from 0 to 2147483647
train CartPole-v1 --set gama=0.9 | ppo has no argument 'gama'; it has: learning_rate, n_steps,
train CartPole-v1 --set gamma | NAME=VALUE ... 'gamma'
train CartPole-v1 --set gamma=high | ppo: gamma must be a number
train CartPole-v1 --set environment.medium=moon | CartPole-v1 cannot be made
train CartPole-v1 --settings my.toml | cannot read the settings my.toml
train CartPole-v1 --settings bad.toml | bad.toml is not TOML
train CartPole-v1 --out old | old holds a training run already: choose another folder with --out
train mjgranular/ChainSwim-v0 --set environment.medium=moon | no medium 'moon'
train --resume nowhere | nowhere holds no training run
train --resume old | old holds no training run (config.json
train CartPole-v1 --resume old | --resume uses the settings of old: remove ENV
evaluate | evaluate needs a run, a policy or, with --agent, an
evaluate nowhere | no run folder or policy 'nowhere'
evaluate old | old holds no training run (config.json
evaluate CartPole-v1 | CartPole-v1 is an environment ... --agent
evaluate CartPole-v1 --agent human | no agent 'human'; there are: policy, zero, random,
evaluate CartPole-v1 --agent gait | there is no scripted gait for CartPole-v1
evaluate CartPole-v1 --agent zero --seeds 1 | an evaluation needs at least 2 seeds
evaluate CartPole-v1 --agent zero --on medium | NAME=VALUE,NAME=VALUE ... 'medium'
evaluate CartPole-v1 --agent zero --gait waves=1 | --gait is for --agent
evaluate Hexapod-v0/ppo-0 --env CartPole-v1 | observations of CartPole-v1 must be
evaluate Hexapod-v0/ppo-0 --on medium=moon | no medium 'moon'; there are: glass_beads, glass
sweep --speed 3 | Unrecognized or misplaced options: --speed
sweep --of "impact --speed 2" | speed is varied, and --speed 2.0 fixes it: omit one of the
sweep --vary angle=10:30:3 --of "impact --angle 20" | angle is varied, and --angle 20.0 fixes it
sweep --vary height=1:3:3 --of "impact --height 2" | height is varied, and --height 2.0 fixes it
sweep --of "drop block.xml --velocity 3" --vary velocity=1,2 | --velocity 3.0 fixes it: omit one
sweep --workers -1 | at least 1 worker ... -1
intrude --tilt 400 | the tilt must be within 180 degrees (pi = 3.1416 rad) either way ... 400
intrude --direction 400 | the direction must be within 180 degrees (pi = 3.1416 rad)
intrude --depth 0.05 --distance 0.2 | --depth and --distance both
impact --body sphere | capsules and cylinders; take a medium whose own law takes every shape
impact --memory 1cm | memory, the side of a cell, must be a number, not '1cm'
drop block.xml --geoms block --bodies blck | no body of the model 'blck' ... did you mean block?
evaluate Hexapod-v0/ppo-0 --seeds 0 | seeds must be at least 1, not 0
"""
_FRAME = str.maketrans("╭╮╰╯│─", " " * 6)  # around the parser's own messages
CASES = [tuple(part.strip() for part in line.split("|")) for line in MISTAKES.strip().splitlines()]


@pytest.fixture
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with files of a user, the current one."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("typed", "words"),
    [  # one in four is tried by the fast tests
        pytest.param(*case, id=case[0], marks=pytest.mark.slow if number % 4 else ())
        for number, case in enumerate(CASES)
    ],
)
def test_a_silly_mistake_is_told_in_one_sentence(
    at_home: Path, capfd: pytest.CaptureFixture[str], typed: str, words: str
) -> None:
    before = {path: path.read_bytes() for path in at_home.rglob("*") if path.is_file()}
    try:
        status = main(shlex.split(typed))
    except SystemExit as stopped:  # the parser of the command line
        status = stopped.code
    said = capfd.readouterr()

    assert status == 2
    assert said.out == ""
    assert "Traceback" not in said.err
    told = " ".join(said.err.translate(_FRAME).split())
    assert told.count("error: ") <= 1
    for word in words.split(" ... "):
        assert word in told
    assert {path: path.read_bytes() for path in at_home.rglob("*") if path.is_file()} == before


def test_integers_may_be_written_as_floats() -> None:
    assert [parse_integer(text) for text in ("12", "1_000", "1e6", "-2e0")] == [12, 1000, 10**6, -2]
    for text in ("1.5", "1e-3", "inf", "nan", "many", "", "1e300"):
        with pytest.raises(ValueError, match="integer"):
            parse_integer(text)
