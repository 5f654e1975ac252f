"""Tasks of mjlab on sand, by MuJoCo Warp."""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportAttributeAccessIssue=false, reportMissingImports=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false

import warnings
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.managers.event_manager import EventTermCfg
from mjlab.sim import MujocoCfg

from mjgranular.envs.ranges import SandRanges
from mjgranular.errors import InputError, UnfeltWarning, listed, warn_user
from mjgranular.shape.sizes import name_of
from mjgranular.warp import WarpSand

TERRAIN = "terrain"  # mjlab's name of the ground's body, and of its geom if that is a plane

# What a contact sensor may contain, in the order of `mujoco.mjtConDataField`, and its numbers.
_FOUND, _FORCE, _TORQUE, _DIST, _POS, _NORMAL = range(6)
_SIZES = (1, 3, 3, 1, 3, 3, 3, 3, 3)
_NETFORCE = 3  # in `sensor_intprm`: the sum of all contacts, in the world frame


@dataclass
class SandMujocoCfg(MujocoCfg):
    """mjlab's options of MuJoCo, with sand: `sand` has arguments of `WarpSand`."""

    sand: dict[str, Any] = field(default_factory=dict)

    def apply(self, model: mujoco.MjModel) -> None:
        """Set the options of a compiled model, and make its sand."""
        super().apply(model)
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "MuJoCo's sensors", UnfeltWarning)  # see _attach
            self.made = WarpSand(model, **self.sand)


def on_sand(
    cfg: ManagerBasedRlEnvCfg,
    *,
    strength: tuple[float, float] = (1.0, 1.0),
    density: tuple[float, float] = (1.0, 1.0),
    **sand: Any,
) -> ManagerBasedRlEnvCfg:
    """Put the robots of a task of mjlab on sand, in place of its flat ground.

    Contact sensors between the robot and the ground, or anything, read the sand: `found`, `force`,
    `dist`, `normal` and `tangent`, of the whole body of a geom, summed over a subtree, in place of
    other contacts of their first slot except in sums (`netforce`). A warning names those that
    cannot. Friction of geoms has no effect.

    Args:
        cfg: configuration of the task, otherwise complete; it is changed.
        strength: factor on static resistance, (low, high), drawn for each episode.
        density: factor on rate-dependent resistance, (low, high), drawn for each episode.
        **sand: arguments of `WarpSand`, such as `medium`, `geoms` and `resolution`.

    Returns:
        The same configuration.

    Raises:
        InputError: the task's ground is not flat, or a range is not possible.
    """
    ground = cfg.scene.terrain
    if ground is None or ground.terrain_type != "plane":
        kind = None if ground is None else ground.terrain_type
        raise InputError(f"on_sand takes a task of mjlab with terrain_type='plane', not {kind!r}")
    ranges = SandRanges(strength=strength, density=density)
    options = {name: getattr(cfg.sim.mujoco, name) for name in MujocoCfg.__dataclass_fields__}
    cfg.sim.mujoco = SandMujocoCfg(**options, sand={"instead_of": [TERRAIN], **sand})
    cfg.events["sand"] = EventTermCfg(func=_attach, mode="startup")
    drawn = {"strength": ranges.strength, "density": ranges.density}
    cfg.events["sand_of_episode"] = EventTermCfg(func=draw_sand, mode="reset", params=drawn)
    return cfg


def sand_of(env: ManagerBasedRlEnv) -> WarpSand:
    """Return the sand of an environment: forces, depths and factors of all worlds."""
    return env.unwrapped.sim.sand


def draw_sand(env: ManagerBasedRlEnv, env_ids: torch.Tensor | None, **ranges: Any) -> None:
    """Draw factors on the sand of some worlds, each uniformly from (low, high)."""
    chosen = slice(None) if env_ids is None else env_ids
    for name, (low, high) in ranges.items():
        factor = wp.to_torch(getattr(sand_of(env), name))
        factor[chosen] = torch.empty_like(factor[chosen]).uniform_(low, high)


def _attach(env: ManagerBasedRlEnv, env_ids: torch.Tensor | None) -> None:
    """Attach the sand, and have contact sensors read it."""
    sand = vars(env.cfg.sim.mujoco).pop("made", None)  # other environments may share this cfg
    if sand is None:
        raise InputError("cfg.sim.mujoco was replaced after on_sand: use on_sand after that")
    env.sim.sand, model = sand, env.sim.wp_model
    sand.attach(model, env.sim.wp_data)
    rows, slots = _contact_sensors(env.sim.mj_model, sand)
    device = sand.force.device
    there = wp.array(rows, dtype=int, device=device), wp.array(slots, dtype=int, device=device)
    before = model.callback.sensor

    def read_sand(m: Any, d: Any, stage: Any) -> None:
        before(m, d, stage)
        if rows and int(stage) == int(mujoco.mjtStage.mjSTAGE_ACC):
            read = (*there, sand.force, sand.depth, d.sensordata)
            wp.launch(_read_sand, dim=(d.nworld, len(rows)), inputs=read, device=device)

    model.callback.sensor = read_sand
    env.sim.create_graph()


def _contact_sensors(
    model: mujoco.MjModel, sand: WarpSand
) -> tuple[list[tuple[int, ...]], list[int]]:
    """Return the values of contact sensors that read sand, and the bodies of each, one by one.

    A value has its address, its kind, whether it is a sum, and where its bodies begin and end.
    """
    kinds, slots, rows = mujoco.mjtObj, [], []
    whole = int(kinds.mjOBJ_XBODY)  # of a body and all of its descendants
    bodies = [model.body(int(name) if name.isdigit() else name).id for name in sand.bodies]
    ground = {(int(kinds.mjOBJ_UNKNOWN), -1), (int(kinds.mjOBJ_GEOM), model.geom(TERRAIN).id)}
    ground |= {(kind, model.body(TERRAIN).id) for kind in (int(kinds.mjOBJ_BODY), whole)}
    numb = [mujoco.mjtSensor.mjSENS_TOUCH, mujoco.mjtSensor.mjSENS_TACTILE]
    unread = [name_of(model, "sensor", n) for n in np.isin(model.sensor_type, numb).nonzero()[0]]
    for n in (model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT).nonzero()[0]:
        kind, own, first = int(model.sensor_objtype[n]), int(model.sensor_objid[n]), len(slots)
        if (kind, own) in ground:
            unread.append(name_of(model, "sensor", n))
        if (int(model.sensor_reftype[n]), int(model.sensor_refid[n])) not in ground:
            continue
        own = int(model.geom_bodyid[own]) if kind == int(kinds.mjOBJ_GEOM) else own
        for slot, body in enumerate(bodies):
            while kind == whole and body > own:
                body = int(model.body_parentid[body])
            if body == own:
                slots.append(slot)
        address, (content, reduce, _) = int(model.sensor_adr[n]), model.sensor_intprm[n][:3]
        for value, size in enumerate(_SIZES):
            if content & 1 << value:
                if value in (_TORQUE, _POS):
                    unread.append(name_of(model, "sensor", n))
                else:
                    rows.append((address, value, int(reduce == _NETFORCE), first, len(slots)))
                address += size
    if unread:
        warn_user(
            "touch and tactile sensors read nothing of the sand, contact sensors no torque, no "
            f"pos and nothing with the ground as primary ({listed(unread)})",
            UnfeltWarning,
        )
    return rows, slots


@wp.kernel
def _read_sand(
    rows: wp.array2d(dtype=int),
    slots: wp.array(dtype=int),
    force: wp.array2d(dtype=wp.vec3),
    depth: wp.array2d(dtype=float),
    sensordata: wp.array2d(dtype=float),
):
    """Write the sand's part of a value of a contact sensor, from the ground's side."""
    world, row = wp.tid()
    a, value, is_sum = rows[row, 0], rows[row, 1], rows[row, 2] == 1
    total, deepest = wp.vec3(), float(0.0)
    for k in range(rows[row, 3], rows[row, 4]):
        total += force[world, slots[k]]
        deepest = wp.max(deepest, depth[world, slots[k]])
    if wp.length(total) == 0.0:
        return
    if value == wp.static(_FOUND):
        sensordata[world, a] += 1.0
        return
    if value == wp.static(_DIST):
        sensordata[world, a] = -deepest
        return
    n, t = wp.vec3(0.0, 0.0, -1.0), wp.vec3(1.0, 0.0, 0.0)  # the frame of a contact
    if is_sum:
        n, t = wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)
    read = wp.where(value == wp.static(_NORMAL), n, t)
    if value == wp.static(_FORCE):
        read = -wp.vec3(wp.dot(total, n), wp.dot(total, t), wp.dot(total, wp.cross(n, t)))
    for i in range(3):
        if value == wp.static(_FORCE) and is_sum:
            read[i] += sensordata[world, a + i]
        sensordata[world, a + i] = read[i]
