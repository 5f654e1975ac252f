"""Silly mistakes in Python, drawn up from the documents alone: one sentence of ours each."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import mjgranular as mg
from mjgranular.calibrate import Fit, run_fit
from mjgranular.engine import relief_of, rne_post_constraint, tune
from mjgranular.engine.sensor import SandReadings
from mjgranular.errors import GranularError, MissedStepWarning
from mjgranular.experiment import (
    Impact,
    Study,
    run_impact,
    run_study,
)
from mjgranular.experiment.drop import Drop, run_drop
from mjgranular.experiment.intrusion import Intrusion, run_intrusion
from mjgranular.law.kernel import LawKernel, Level
from mjgranular.medium.file import read_medium
from mjgranular.models import Link, model_path
from mjgranular.relief.memory import heights_of

BLOCK = """
<mujoco model="block">
  <worldbody>
    <geom name="tray" type="box" size="1 1 .1" pos="0 0 -.1" contype="0" conaffinity="0"/>
    <body name="block" pos="0 0 0.2">
      <freejoint/>
      <geom name="block" type="box" size="0.05 0.03 0.02" density="2000"/>
    </body>
  </worldbody>
</mujoco>
"""

NAMES = BLOCK.replace('body name="block"', 'body name="torso"').replace(
    'geom name="block"', 'geom name="foot"'
)


def made(config: str) -> mujoco.MjModel:
    """The block with sand."""
    instance = f"<instance name='s'>{config}</instance>"
    extension = f"<extension><plugin plugin='mjgranular.sand'>{instance}</plugin></extension>"
    return mujoco.MjModel.from_xml_string(BLOCK.replace("<worldbody>", f"{extension}<worldbody>"))


def sand(**fields: Any) -> mg.Sand:
    return mg.Sand(mujoco.MjModel.from_xml_string(BLOCK), **fields)


def added(*arguments: Any, **fields: Any) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(BLOCK)
    mg.add_sand(spec, *arguments, **fields)
    return spec.compile()


def quantity(value: Any) -> mg.Quantity:
    return mg.Quantity(value, "kg/m^3", "weighed")


def medium(**fields: Any) -> mg.Medium:
    plain: Any = {"name": "a", "title": "a", "density": quantity(1500), "default_law": "link"}
    return mg.Medium(**{**plain, **fields})


def evaluated(make_agent: Any, **options: Any) -> Any:
    pytest.importorskip("stable_baselines3")
    from mjgranular.learn.evaluate import evaluate

    return evaluate("mine", make_agent, "Pendulum-v1", {}, **options)


def on_sand(*arguments: Any, **options: Any) -> Any:
    pytest.importorskip("gymnasium")
    from mjgranular import envs

    return envs.on_sand(*arguments, **options)


def gymnasium_hopper() -> Any:
    return pytest.importorskip("gymnasium.envs.mujoco.hopper_v5").HopperEnv


def task(name: str, **options: Any) -> Any:
    gym = pytest.importorskip("gymnasium")
    import mjgranular.envs  # noqa: F401

    return gym.make(f"mjgranular/{name}-v0", **options)


def ranges(**options: Any) -> Any:
    pytest.importorskip("gymnasium")
    from mjgranular.envs import SandRanges

    return SandRanges(**options)


def vec(name: str, num_envs: Any, **options: Any) -> Any:
    pytest.importorskip("stable_baselines3")
    from mjgranular.envs.sb3 import make_vec_env

    return make_vec_env(name, num_envs, **options)


def batch(name: str, **options: Any) -> Any:
    gym = pytest.importorskip("gymnasium")
    import mjgranular.envs  # noqa: F401

    return gym.make_vec(f"mjgranular/{name}-v0", num_envs=2, **options)


def registered(task: Any) -> Any:
    pytest.importorskip("gymnasium")
    from mjgranular.envs.ids import register_task

    return register_task(task)


def unfinished() -> type:
    pytest.importorskip("gymnasium")
    from mjgranular.envs import Task

    return type("Nothing", (Task,), {})


def gait_of(task: Any) -> Any:
    from mjgranular.envs.gaits import gait

    return gait(task)


def stepped(action: Any) -> Any:
    env = task("LinkDrop")
    env.reset(seed=0)
    return env.unwrapped.step(action)


MODEL = mujoco.MjModel.from_xml_string(BLOCK)
DATA = mujoco.MjData(MODEL)

MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "path for model": (lambda: mg.Sand("robot.xml"), "Sand takes an MjModel"),
    "spec for model": (
        lambda: mg.Sand(mujoco.MjSpec.from_string(BLOCK)),
        "Sand takes an MjModel",
    ),
    "data for model": (lambda: mg.Sand(DATA), "Sand takes an MjModel"),
    "nothing for model": (lambda: mg.Sand(None), "Sand takes an MjModel"),
    "medium by place": (lambda: mg.Sand(MODEL, "play_sand"), "sand is described by a SandSpec"),
    "misspelt field": (
        lambda: sand(medum="play_sand"),
        "a sand has no argument 'medum' ... did you mean medium?",
    ),
    "misspelt field of a spec": (
        lambda: mg.SandSpec(medum="play_sand"),
        "SandSpec.__init__() got an unexpected keyword argument 'medum'",
    ),
    "medium with a blank": (
        lambda: sand(medium="play sand"),
        "no medium 'play sand'; there are: "
        "glass_beads, glass_beads_3mm_close, ... did you mean play_sand?",
    ),
    "empty medium": (lambda: sand(medium=""), "no medium ''; there are: glass_beads, glass"),
    "number for medium": (
        lambda: sand(medium=1500),
        "no medium 1500; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "bytes for medium": (
        lambda: sand(medium=b"play_sand"),
        "no medium b'play_sand'; there are: "
        "glass_beads, glass_beads_3mm_close, ... did you mean play_sand?",
    ),
    "list for medium": (
        lambda: sand(medium=["play_sand"]),
        "no medium ['play_sand']; there are: "
        "glass_beads, glass_beads_3mm_close, ... did you mean play_sand?",
    ),
    "dict for medium": (lambda: sand(medium={"density": 1500}), "a medium is a Medium, its name"),
    "missing medium file": (
        lambda: sand(medium="my_sand.yaml"),
        "cannot read the medium my_sand.yaml",
    ),
    "medium without the law": (
        lambda: sand(medium="play_sand", law="rft3d"),
        "no constants in medium 'play_sand' for law 'rft3d'; there are: link, rft2d",
    ),
    "law's name": (
        lambda: sand(law="rtf3d"),
        "no law 'rtf3d'; there are: depth_velocity, link, ... did you mean rft3d?",
    ),
    "law's empty name": (lambda: sand(law=""), "no law ''; there are: depth_velocity, link,"),
    "number for law": (lambda: sand(law=3), "no law 3; there are: depth_velocity, link,"),
    "law's option": (lambda: sand(law="rft3d scael=2"), "the law 'rft3d' has no option 'scael'"),
    "law's value": (lambda: sand(law="rft3d scale=two"), "scale must be a number, not"),
    "function for law": (
        lambda: sand(law=lambda z: z),
        "no law <function <lambda>.<locals>.<lambda>",
    ),
    "law's number": (
        lambda: mg.Rft3dLaw(3000, 0.4, 0.4, scale="1"),
        "Rft3dLaw: scale must be finite and not negative",
    ),
    "law that is not finite": (
        lambda: sand(law=mg.DepthVelocityLaw(stiffness=math.nan)),
        "DepthVelocityLaw: stiffness must be finite and not negative",
    ),
    "text in a law": (
        lambda: mg.DepthVelocityLaw(stiffness="hard"),
        "DepthVelocityLaw: stiffness must be finite and not negative",
    ),
    "law of a missing medium": (
        lambda: mg.Rft3dLaw.from_medium("moon"),
        "no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "surface's name": (
        lambda: sand(surface="floor"),
        "no surface 'floor'; there are: bed, height_field, plane",
    ),
    "number for surface": (
        lambda: sand(surface=0.1),
        "a surface is needed, not 0.1; use Plane(height=...),",
    ),
    "list for surface": (
        lambda: sand(surface=[0, 0, 0.1]),
        "a surface is needed, not a list; use Plane(height=...),",
    ),
    "class for surface": (
        lambda: sand(surface=mg.Plane),
        "a surface is needed, not the class Plane; use",
    ),
    "text for height": (lambda: mg.Plane(height="0.1"), "the plane's height must be finite"),
    "nothing for height": (lambda: mg.Plane(height=None), "the plane's height must be finite"),
    "degrees for slope": (
        lambda: mg.Plane(slope=30),
        "less than 90 degrees (pi/2 = 1.5708 rad), not 30 rad: 30 degrees are 0.5236",
    ),
    "degrees for uphill": (
        lambda: mg.Plane(slope=0.2, uphill=90),
        "uphill is an angle in radians, from -2 pi to 2 pi, not 90: 90 degrees are 1.571",
    ),
    "middle in space": (
        lambda: heights_of(np.zeros(9), mg.Memory(), (0, 0, 0)),
        "the middle is two numbers [m], not [0, 0, 0]",
    ),
    "model to release": (
        lambda: sand().release(MODEL),
        "Sand takes an MjData, not an MjModel",
    ),
    "steps of nothing": (
        lambda: on_sand("Hopper-v5", frame_skip=0),
        "frame_skip must be at least 1, not 0",
    ),
    "endless height": (lambda: mg.Plane(height=math.inf), "the plane's height must be finite"),
    "geom of a bed": (
        lambda: sand(surface=mg.Bed("tary")),
        "no box geom of the model 'tary' ... did you mean tray?",
    ),
    "number for a bed": (lambda: mg.Bed(7), "a bed is given by the name of its geom, not by 7"),
    "number for a height field": (
        lambda: mg.HeightField(0),
        "a height field is given by the name of its geom, not by 0",
    ),
    "bed that moves": (lambda: sand(surface=mg.Bed("block")), "geom 'block' is on body 'block'"),
    "height field that is a box": (
        lambda: sand(surface=mg.HeightField("tray")),
        "geom 'tray' is a box: a height field is made of a hfield geom",
    ),
    "scheme's name": (lambda: sand(scheme="RK4"), "no scheme 'RK4'; there are: auto, explicit,"),
    "no scheme": (lambda: sand(scheme=None), "no scheme None; there are: auto, explicit,"),
    "number for scheme": (lambda: sand(scheme=1), "no scheme 1; there are: auto, explicit,"),
    "scheme's option": (
        lambda: mg.Implicit(evaluations=0),
        "Implicit: evaluations must be at least 1",
    ),
    "body's name": (
        lambda: sand(bodies="blok"),
        "no body of the model 'blok'; there are: world, block ... did you mean block?",
    ),
    "empty body": (lambda: sand(bodies=""), "no body of the model ''; there are: world,"),
    "half a body": (lambda: sand(bodies=1.5), "bodies and geoms are chosen by names or numbers"),
    "bytes for bodies": (
        lambda: sand(bodies=b"block"),
        "bodies and geoms are chosen by names or numbers",
    ),
    "view for geoms": (
        lambda: sand(geoms=[MODEL.geom("block")]),
        "bodies and geoms are chosen by names or numbers",
    ),
    "geom's number": (
        lambda: sand(geoms=99),
        "the model has no geom number 99: they go from 0 to 1",
    ),
    "geom's negative number": (
        lambda: sand(geoms=-1),
        "the model has no geom number -1: they go from 0 to 1",
    ),
    "group": (
        lambda: sand(groups=9),
        "no geoms of bodies that can move in geom group 9; there are: 0",
    ),
    "text for groups": (lambda: sand(groups="0"), "groups takes the number of a geom group"),
    "text for resolution": (
        lambda: sand(resolution="fine"),
        "the resolution must be an integer",
    ),
    "no resolution": (lambda: sand(resolution=0), "the resolution must be at least 2"),
    "half a resolution": (lambda: sand(resolution=2.5), "the resolution must be an integer"),
    "resolution not a number": (
        lambda: sand(resolution=math.nan),
        "the resolution must be an integer",
    ),
    "yes for resolution": (lambda: sand(resolution=True), "the resolution must be an integer"),
    "huge resolution": (lambda: sand(resolution=10**9), "the resolution must be at most 200"),
    "floor's name": (lambda: sand(instead_of="floor"), "no geom of the model 'floor'"),
    "block as floor": (lambda: sand(instead_of="block"), "geom 'block' is on body 'block'"),
    "model for data": (
        lambda: sand().step(MODEL),
        "Sand takes an MjData, not an MjModel; use",
    ),
    "nothing for data": (lambda: sand().step(None), "Sand takes an MjData, not None; use"),
    "another's data": (
        lambda: sand().step(DATA),
        "this MjData belongs to another model, as a deep copy or a pickle of one always does",
    ),
    "model for report": (
        lambda: sand().report(MODEL),
        "Sand takes an MjData, not an MjModel; use",
    ),
    "body of a report": (
        lambda: mg.Sand(MODEL).report(DATA)["blok"],
        "no body with sand on it 'blok' ... did you mean block?",
    ),
    "model for add_sand": (lambda: mg.add_sand(MODEL), "add_sand takes an MjSpec"),
    "medium of add_sand": (
        lambda: added(medium="moon"),
        "no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "medium by place of add_sand": (lambda: added("play_sand"), "sand is described by a SandSpec"),
    "field of add_sand": (
        lambda: added(medum="play_sand"),
        "a sand has no argument 'medum' ... did you mean medium?",
    ),
    "drawing": (lambda: added(draw="arrows"), "config 'draw': no drawing 'arrows'"),
    "number for a drawing": (lambda: added(draw=3), "config 'draw': no drawing '3'"),
    "law's option of add_sand": (
        lambda: added(law="rft3d scael=2"),
        "config 'law': the law 'rft3d' has no option 'scael'",
    ),
    "body of add_sand": (
        lambda: added(bodies="blok"),
        "mjgranular 'sand': no body of the model 'blok' ... did you mean block?",
    ),
    "number for a name": (lambda: added(name=3), "name of an instance"),
    "law in MJCF": (
        lambda: made("<config key='law' value='rft3d scael=2'/>"),
        "mjgranular 's': config 'law': the law 'rft3d' has no option 'scael'",
    ),
    "body in MJCF": (
        lambda: made("<config key='bodies' value='blok'/>"),
        "mjgranular 's': no body of the model 'blok' ... did you mean block?",
    ),
    "key in MJCF": (
        lambda: made("<config key='medum' value='play_sand'/>"),
        "unrecognized attribute 'plugin:medum' for plugin mjgranular.sand",
    ),
    "density of a medium": (
        lambda: mg.Medium(name="a", title="a", density=1500, default_law="link", constants={}),
        "medium 'a': the bulk density is a Quantity(value",
    ),
    "density without effect": (
        lambda: mg.Sand(MODEL, medium="quikrete_medium density=3000"),
        "the density of the medium has no effect under the law rft3d_dynamic",
    ),
    "density without effect, after two spaces": (
        lambda: mg.Sand(MODEL, medium="quikrete_medium  density=1550", law="rft3d"),
        "the density of the medium has no effect under the law rft3d",
    ),
    "sample without a length": (
        lambda: LawKernel(Level, Level, None, None),
        "the first fields of Level must be depth, length and point, in this order, not normal",
    ),
    "text for a quantity": (lambda: quantity("1500"), "a quantity's value is a number"),
    "endless density": (
        lambda: mg.Medium(
            name="a", title="a", density=quantity(math.inf), default_law="link", constants={}
        ),
        "medium 'a': the bulk density must be from 10 to 25000 kg/m^3",
    ),
    "medium to register": (
        lambda: mg.register_medium("play_sand"),
        "register_medium takes a Medium",
    ),
    "law to register": (
        lambda: mg.register_law("rft3d"),
        "a law is a class that derives from mjgranular.Law",
    ),
    "law that is none": (
        lambda: mg.register_law(dict),
        "a law is a class that derives from mjgranular.Law",
    ),
    "name of a model": (
        lambda: model_path("lnik"),
        "no model 'lnik'; there are: chain7, double_pendulum, link ... did you mean link?",
    ),
    "size of a link": (lambda: Link(length=0), "the link's length must be positive and finite"),
    "text for a size": (
        lambda: Link(length="0.2"),
        "the link's length must be positive and finite",
    ),
    "sand to tune": (
        lambda: tune(added(tunable=True), np.zeros(4), "s"),
        "no sand of the model 's'; there are:",
    ),
    "sand that is not tunable": (
        lambda: tune(added(), np.zeros(4), "sand", strength=2),
        "the sand 'sand' is not tunable: make it with add_sand(...",
    ),
    "negative strength": (
        lambda: tune(added(tunable=True), np.zeros(4), "sand", strength=-1),
        "strength must be finite and not negative",
    ),
    "environment": (
        lambda: on_sand("Ant"),
        "no environment 'Ant' ... did you mean Ant-v5?",
    ),
    "environment without MuJoCo": (
        lambda: on_sand("CartPole-v1"),
        "CartPole-v1 is not one of Gymnasium's MuJoCo environments: on_sand takes classes",
    ),
    "number for environment": (
        lambda: on_sand(5),
        "an environment is named by a string such as 'Ant-v5'",
    ),
    "nothing for environment": (
        lambda: on_sand(None),
        "an environment is named by a string such as 'Ant-v5'",
    ),
    "class that is none": (
        lambda: on_sand(dict),
        "dict is not one of Gymnasium's MuJoCo environments: on_sand takes classes that",
    ),
    "environment with its own simulation": (
        lambda: on_sand(
            type("Heavy", (gymnasium_hopper(),), {"_initialize_simulation": lambda self: None})
        ),
        "Heavy has its own _initialize_simulation, which on_sand replaces: change the model in",
    ),
    "medium of an environment": (
        lambda: on_sand("Hopper-v5", medium="moon"),
        "no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "option of an environment": (
        lambda: on_sand("Hopper-v5", medum="play_sand"),
        "on_sand(Hopper-v5) has no argument 'medum' ... did you mean medium?",
    ),
    "body of an environment": (
        lambda: on_sand("Hopper-v5", bodies="foto"),
        "no body of the model 'foto' ... did you mean foot?",
    ),
    "sand of an environment": (
        lambda: on_sand("Hopper-v5", "play_sand"),
        "sand is described by a SandSpec",
    ),
    "option of a task": (
        lambda: task("Hexapod", medum="play_sand"),
        "Hexapod has no option 'medum'",
    ),
    "medium of a task": (
        lambda: task("Hexapod", medium="moon"),
        "no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "camera of a task": (
        lambda: task("Hexapod", render_mode="rgb_array", camera_name="top"),
        "no camera 'top'; there are:",
    ),
    "mode of a task": (
        lambda: task("Hexapod", render_mode="video"),
        "render_mode must be None or one of human",
    ),
    "range upside down": (
        lambda: ranges(strength=(2, 0.5)),
        "SandRanges: strength has its low end above its high end:",
    ),
    "number for a range": (lambda: ranges(strength=2.0), "SandRanges: strength must be"),
    "texts in a range": (lambda: ranges(strength=("a", "b")), "SandRanges: strength must be"),
    "range that ends nowhere": (
        lambda: ranges(strength=(0.5, math.nan)),
        "SandRanges: strength must be finite",
    ),
    "range of a medium": (
        lambda: ranges(media=("moon",)),
        "no medium 'moon'; there are: glass_beads, glass_beads_3mm_close,",
    ),
    "short action": (lambda: stepped(np.zeros(1)), "Action dimension mismatch. Expected"),
    "action not a number": (
        lambda: stepped(np.full(2, math.nan)),
        "an action must be finite, not [nan",
    ),
    "text for an action": (lambda: stepped("left"), "Action dimension mismatch. Expected"),
    "batch of none": (lambda: vec("mjgranular/LinkDrop-v0", 0), "num_envs must be at least 1, not"),
    "batch of somebody's": (
        lambda: vec("CartPole-v1", 2),
        "CartPole-v1 has no batch of mjgranular's",
    ),
    "text for a weight": (
        lambda: vec("mjgranular/Hopper-v0", 2, forward_reward_weight="big"),
        "forward_reward_weight must be a finite number, not 'big'",
    ),
    "weight that is none": (
        lambda: vec("mjgranular/Hopper-v0", 2, healthy_reward=math.nan),
        "healthy_reward must be a finite number, not nan",
    ),
    "number for a range of health": (
        lambda: vec("mjgranular/Hopper-v0", 2, healthy_z_range=0.7),
        "healthy_z_range must be a range, (low, high), not 0.7",
    ),
    "range of health upside down": (
        lambda: vec("mjgranular/Hopper-v0", 2, healthy_z_range=(2, 1)),
        "healthy_z_range must be a range with its low end first, not [2, 1]",
    ),
    "text for a switch": (
        lambda: vec("mjgranular/Hopper-v0", 2, observe_sand="no"),
        "observe_sand must be True or False, not 'no'",
    ),
    "medium of a number": (lambda: read_medium(3), "a medium is read from a file, not from 3"),
    "word for tunable": (lambda: added(tunable="no"), "tunable must be True or False, not 'no'"),
    "word for shared": (lambda: sand(shared="no"), "shared must be True or False, not 'no'"),
    "words for memory": (
        lambda: sand(memory="yes please"),
        "memory, the side of a cell, must be a number, not 'yes please'",
    ),
    "empty memory": (lambda: sand(memory=""), "memory is the side of a cell [m]"),
    "word for a switch of a law": (
        lambda: mg.Rft3dLaw(3000, 0.4, 0.4, rise="no"),
        "Rft3dLaw: rise must be True or False, not 'no'",
    ),
    "half an evaluation": (
        lambda: mg.Implicit(evaluations=2.5),
        "Implicit: evaluations must be an integer, not 2.5",
    ),
    "data for a state": (
        lambda: tune(added(tunable=True), DATA, "sand", strength=2),
        "not to an MjData; use data.plugin_state",
    ),
    "path for a model to tune": (
        lambda: tune("robot.xml", np.zeros(4), "sand"),
        "tune takes an MjModel, not 'robot.xml'",
    ),
    "text for a strength": (
        lambda: tune(added(tunable=True), np.zeros(4), "sand", strength="2"),
        "strength must be a number, or one for each simulation, not '2'",
    ),
    "half a sand": (
        lambda: tune(added(tunable=True), np.zeros(4), "sand", active=0.5),
        "active must be 0 or 1, False or True, not 0.5",
    ),
    "strengths of others": (
        lambda: tune(added(tunable=True), np.zeros((3, 4)), "sand", strength=[1, 2]),
        "one for each simulation, shape (3,), not of shape (2,)",
    ),
    "nothing for data in the engine": (
        lambda: rne_post_constraint(MODEL, None),
        "rne_post_constraint takes an MjData, not None",
    ),
    "model and data the wrong way round": (
        lambda: relief_of(DATA, MODEL),
        "relief_of takes an MjModel, not an MjData; use",
    ),
    "quantity that is none": (
        lambda: quantity("1500"),
        "a quantity's value is a number, not '1500'",
    ),
    "name for a task": (
        lambda: registered("x"),
        "a task is a class that derives from mjgranular.envs.Task, not 'x'",
    ),
    "class that is no task": (lambda: registered(int), "not the class int"),
    "task without a robot": (lambda: registered(unfinished()), "the task Nothing lacks observe,"),
    "text for a number of simulations": (
        lambda: vec("mjgranular/LinkDrop-v0", "8"),
        "num_envs must be an integer, not '8'",
    ),
    "half a simulation": (
        lambda: vec("mjgranular/LinkDrop-v0", 2.5),
        "num_envs must be an integer, not 2.5",
    ),
    "text for threads": (
        lambda: vec("mjgranular/LinkDrop-v0", 2, threads="many"),
        "threads must be an integer, not 'many'",
    ),
    "fewer than no threads": (
        lambda: vec("mjgranular/LinkDrop-v0", 2, threads=-1),
        "threads must be at least 0, not -1",
    ),
    "noise below zero": (
        lambda: task("Hopper", reset_noise_scale=-1),
        "reset_noise_scale must not be negative, not -1",
    ),
    "number for a curriculum": (
        lambda: task("Hopper", randomise=ranges(strength=(1, 2)), curriculum=3),
        "a curriculum is a function of the number of the episode that gives a SandRanges, not 3",
    ),
    "list for ranges": (
        lambda: task("Hopper", randomise=[1, 2]),
        "randomise takes a SandRanges, not a list; use SandRanges(strength=(0.5, 2), ...)",
    ),
    "gait of an environment": (
        lambda: gait_of(task("LinkDrop")),
        "gait takes a Task, not",
    ),
    "gait of an id": (lambda: gait_of("mjgranular/LinkDrop-v0"), "; use env.unwrapped.task"),
    "environment that is made already": (
        lambda: on_sand(task("LinkDrop")),
        "on_sand makes the environment itself, from its class or its id",
    ),
    "size of a picture": (
        lambda: task("LinkDrop", render_mode="rgb_array", width="640"),
        "width must be an integer, not '640'",
    ),
    "batch that begins when it likes": (
        lambda: batch("LinkDrop", autoreset_mode="same"),
        "no autoreset_mode 'same'; there are: NextStep, SameStep, Disabled",
    ),
    "text for a seed": (
        lambda: batch("LinkDrop").reset(seed="1"),
        "a seed must be an integer, or a list of them, not '1'",
    ),
    "text for a speed": (lambda: Impact(speed="10"), "speed must be finite ... '10'"),
    "number for a drop": (lambda: run_impact(10), "run_impact takes an Impact, not 10"),
    "path for a drop": (
        lambda: run_drop("robot.xml"),
        "run_drop takes a Drop, not 'robot.xml'; use Drop(path",
    ),
    "medium without a name": (lambda: medium(name=""), "a medium has a name such as"),
    "number for a medium's name": (lambda: medium(name=3), "a medium has a name such as"),
    "list of constants": (lambda: medium(constants=[1]), "constants are a table of laws, {'rft3d'"),
    "law of an impact": (
        lambda: Impact(law=mg.LinkLaw),
        "medium and law of an impact ... the class LinkLaw",
    ),
    "text for a height": (lambda: Drop("robot.xml", height="1"), "height must be finite and"),
    "policy for its maker": (
        lambda: evaluated(object()),
        "make_agent must be a function",
    ),
    "text for seeds": (
        lambda: evaluated(lambda env: None, seeds="3"),
        "seeds must be an integer, not '3'",
    ),
    "batch of nobody's": (
        lambda: vec("mjgranular/LinkDorp-v0", 2),
        "no environment 'mjgranular/LinkDorp-v0' ... did you mean mjgranular/LinkDrop-v0?",
    ),
    "word for a switch of a scheme": (
        lambda: mg.Explicit(half_step="no"),
        "Explicit: half_step must be True or False, not 'no'",
    ),
    "text for a longest step": (
        lambda: mg.Explicit(longest_step="1"),
        "Explicit: longest_step must be positive, not '1' s",
    ),
    "repose in degrees": (
        lambda: mg.Memory(repose=32),
        "above 0 and below 1.571 rad, not 32",
    ),
    "memory that is too small": (
        lambda: sand(memory=mg.Memory(0.02, extent=0.4)),
        "say memory='cell=0.02 extent=",
    ),
    "way of drawing that there is not": (
        lambda: on_sand("Hopper-v5", render_mode="humann"),
        "render_mode must be None or one of human, rgb_array, ... not 'humann'",
    ),
    "geom of a body's name": (
        lambda: mg.Sand(mujoco.MjModel.from_xml_string(NAMES), geoms="torso"),
        "no geom of the model 'torso' ... (there is a body of that name)",
    ),
    "body of a geom's name": (
        lambda: mg.Sand(mujoco.MjModel.from_xml_string(NAMES), bodies="foot"),
        "no body of the model 'foot' ... (there is a geom of that name)",
    ),
    "pairs for what is varied": (
        lambda: Study(Impact(), [("speed", [1.0])]),  # pyright: ignore[reportArgumentType]
        "must be a table, {'speed': [1, 2]} ... a list",
    ),
    "drop for a study": (
        lambda: run_study(Impact()),  # pyright: ignore[reportArgumentType]
        "run_study takes a Study, not an Impact; use Study(experiment, {'speed'",
    ),
    "folder for a journal": (
        lambda: run_study(Study(Impact(), {"speed": [1.0]}), journal="out"),  # pyright: ignore[reportArgumentType]
        "run_study takes a Journal, not 'out'; use journal_of(study, folder)",
    ),
    "path for an intrusion": (
        lambda: run_intrusion("plate"),  # pyright: ignore[reportArgumentType]
        "run_intrusion takes an Intrusion, not 'plate'",
    ),
    "tilt in degrees": (lambda: Intrusion(tilt=30), "must be within 180 degrees (pi = 3.1416 rad)"),
    "text for an intruder's size": (
        lambda: Intrusion(size="0.04"),  # pyright: ignore[reportArgumentType]
        "the size must be positive and finite ... '0.04'",
    ),
    "model for a drop": (
        lambda: Drop(MODEL),  # pyright: ignore[reportArgumentType]
        "a drop is of an MJCF file, Drop('robot.xml') ... an MjModel ... use Sand",
    ),
    "memory of an impact": (
        lambda: Impact(memory=mg.Memory()),  # pyright: ignore[reportArgumentType]
        "memory of an impact must be the side of a cell [m], or words",
    ),
    "path for a fit": (
        lambda: run_fit("runs.yaml"),  # pyright: ignore[reportArgumentType]
        "run_fit takes a Fit, not 'runs.yaml'; use read_fit('runs.yaml', free=[...])",
    ),
    "path for runs": (
        lambda: Fit(runs="runs.yaml", medium="play_sand", free=("strength",)),  # pyright: ignore[reportArgumentType]
        "runs and free are each several",
    ),
    "report for a film": (
        lambda: mg.show(mg.Sand(MODEL).report(DATA)),
        "show takes pictures of one size, ... not a Report",
    ),
    "film that stands still": (
        lambda: mg.show([np.zeros((4, 4, 3), np.uint8)], fps=0),
        "from 1 to 240, got 0",
    ),
    "text for a density": (
        lambda: mg.Rft3dLaw("1500", 0.4, 0.4),  # pyright: ignore[reportArgumentType]
        "density must be finite and not negative, not '1500'",
    ),
}


# What MuJoCo or Python raises: with our words in it, or of a call of theirs.
THEIRS = {
    "body of add_sand",
    "law in MJCF",
    "body in MJCF",
    "key in MJCF",
    "misspelt field of a spec",
}


@pytest.mark.filterwarnings("ignore:.*render_mode")
@pytest.mark.parametrize("name", MISTAKES)
def test_a_silly_mistake_is_told_in_one_sentence(name: str) -> None:
    mistake, words = MISTAKES[name]
    with pytest.raises((ValueError, TypeError) if name in THEIRS else GranularError) as caught:
        mistake()

    said = str(caught.value)
    assert name in THEIRS or said.isprintable()
    assert len(said) < 450
    for word in words.split(" ... "):
        assert word in said


def test_steps_that_were_all_made_without_the_sand_are_told() -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data = mujoco.MjData(model)
    made_of_it = mg.Sand(model)
    made_of_it.check(data)  # nothing has been missed
    mujoco.mj_step(model, data, 3)
    with pytest.warns(MissedStepWarning, match=r"never acted in this MjData: was mujoco\.mj_step"):
        made_of_it.check(data)
    made_of_it.report(data)  # of a state from anywhere, without a word


def test_after_a_reset_nothing_is_left_of_the_last_step() -> None:
    model = added()
    data, other = mujoco.MjData(model), mujoco.MjData(model)
    readings = SandReadings(model, ("sand",))
    for each in (data, other):
        each.qpos[2] = 0.0
        each.qvel[2] = -1.0
        mujoco.mj_step(model, each)
        assert readings.read(each)[0, 2] > 1.0  # [N]
    mujoco.mj_resetData(model, data)
    assert not readings.read(data).any()
    rne_post_constraint(model, data)
    assert not data.cfrc_ext.any()
    assert readings.read(other)[0, 2] > 1.0  # whom nobody has reset
    rne_post_constraint(model, other)
    assert other.cfrc_ext[1, 5] > 1.0


def test_a_task_that_is_defined_again_takes_its_own_place() -> None:
    pytest.importorskip("gymnasium")
    from mjgranular.envs.link_drop import LinkDrop
    from mjgranular.envs.task import tasks

    again = type("LinkDrop", (LinkDrop,), {"__module__": LinkDrop.__module__})
    try:
        assert registered(again) == "mjgranular/LinkDrop-v0"
        assert tasks["LinkDrop"] is again
    finally:
        registered(LinkDrop)
