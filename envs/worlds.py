"""The worlds of MuJoCo Warp for `SandVectorEnv`, with the methods of `mujoco.batch.Batch`."""

import copy
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import require
from mjgranular.engine.instances import instance_of
from mjgranular.engine.tuning import DENSITY, HEIGHT, INITIAL, STRENGTH
from mjgranular.envs.figures import BAD
from mjgranular.envs.ground import place, quiet
from mjgranular.envs.task import Task
from mjgranular.errors import InputError

require("mujoco_warp", extra="warp", purpose="An environment on MuJoCo Warp")

import mujoco_warp as mjw  # noqa: E402 - after the check with its install line
import warp as wp  # noqa: E402

from mjgranular.warp import WarpSand, coupled  # noqa: E402

_ALWAYS = ("qpos", "qvel", "ctrl")
_STATE = (*_ALWAYS, "act", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat", "eq_active")


class Worlds:
    """Simulations of a task in MuJoCo Warp.

    Bound arrays are in this process: they are read from the device after each step, and written to
    it before the next. The model has `WarpSand` in place of the task's plugin, and the integrator
    `discrete`. `warning`, as in a batch, is of worlds whose state became NaN in the last step; they
    are reset to the model's initial state.
    """

    def __init__(self, task: Task, count: int, device: str | None = None) -> None:
        self._task, self._count, self._full = task, count, task.model
        self._fresh = mujoco.MjData(self._full)
        if len(task.sands) > 1:
            raise InputError(
                "in MuJoCo Warp all worlds have one law and one surface: leave media, laws and "
                "surfaces out of randomise (strength, density and slope may be drawn)"
            )
        spec = task.scene()
        (sand,) = place(spec, task.sands, rigid=task.rigid)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON  # MuJoCo Warp has no PGS
        with quiet():
            self._model = model = coupled(spec).compile()
        self._sand = WarpSand(model, sand)
        try:
            wp.get_device(device)
        except ValueError:
            known = ", ".join(each.alias for each in wp.get_devices())
            raise InputError(
                f"there is no device {device!r} for MuJoCo Warp here; there is: {known}"
            ) from None
        with wp.ScopedDevice(device):
            try:
                self._m = mjw.put_model(model)
            except (NotImplementedError, ValueError) as error:
                raise InputError(f"MuJoCo Warp does not take the task's model: {error}") from None
            self._d = mjw.put_data(model, mujoco.MjData(model), nworld=count)
            self._sand.attach(self._m, self._d)
        self._rows = [model.body(name).id for name in self._sand.bodies]
        self._numbers: dict[str, np.ndarray] = {}
        self._arrays: dict[str, np.ndarray] = {}
        for name in _ALWAYS:
            self.bind(name)
        if task.randomise is None:
            # State of the memory of the task's own sand, which is not used.
            self._arrays["plugin_state"] = np.zeros((count, 0))
        self._drawn = self.bind("plugin_state")
        self._graphs: dict[int, Any] = {}
        self.warning = np.zeros((count, len(mujoco.mjtWarning.__members__), 2), int)

    def bind(self, name: str) -> np.ndarray:
        """Return the array of a field of `mjData`, shape (n, ...)."""
        if name not in self._arrays:
            value = np.asarray(getattr(self._fresh, name))
            if not hasattr(self._d, name) and name not in ("plugin_state", "userdata"):
                raise InputError(f"MuJoCo Warp's data have no {name}, which this task reads")
            self._arrays[name] = np.tile(value.astype(float), (self._count,) + (1,) * value.ndim)
        return self._arrays[name]

    def expand(self, name: str) -> np.ndarray:
        """Return a field of `mjModel` for each world, shape (n, ...)."""
        if name not in self._numbers:
            *owner, field = name.split(".")
            place = attrgetter(*owner)(self._m) if owner else self._m
            value = np.array(attrgetter(name)(self._full), float)
            if not value.ndim or not isinstance(getattr(place, field, None), wp.array):
                raise InputError(
                    f"MuJoCo Warp has no {name} for each world: step this task without it"
                )
            self._numbers[name] = np.tile(value, (self._count,) + (1,) * value.ndim)
            old = getattr(place, field)
            values = self._numbers[name].astype(np.float32)
            setattr(place, field, wp.array(values, dtype=old.dtype, device=old.device))
        return self._numbers[name]

    def step(self, ids: np.ndarray | None = None, nstep: int = 1) -> None:
        """Step all worlds; reset those that are not in `ids` before reading them."""
        self._write()  # a task may write to what it reads
        device = self._d.qpos.device
        if device.is_cuda:
            if nstep not in self._graphs:
                with wp.ScopedCapture(device) as capture:
                    self._steps(nstep)
                self._graphs[nstep] = capture.graph
            wp.capture_launch(self._graphs[nstep])
        else:
            self._steps(nstep)
        self._read(None)
        finite = [np.isfinite(self._arrays[name]).all(1) for name in ("qpos", "qvel")]
        lost = ~(finite[0] & finite[1])
        self.warning[:, BAD.start, 1] = lost
        if lost.any():
            ids, drawn = np.flatnonzero(lost), self._arrays.get("userdata")
            kept = None if drawn is None else drawn[ids]  # what the episode has drawn goes on
            self.reset(ids)
            if drawn is not None:
                drawn[ids] = kept
            self.forward(ids)

    def reset(self, ids: np.ndarray, stage: int = 0) -> None:
        """Reset worlds to the model's initial state."""
        for name, value in self._arrays.items():
            value[ids] = getattr(self._fresh, name) if value.size else 0.0

    def forward(self, ids: np.ndarray) -> None:
        """Write worlds' state, sand and numbers, and compute the derived quantities."""
        self._write()
        for name in ("qacc_warmstart", "act", "time", "history", "plastic"):
            field = getattr(self._d, name)
            values = field.numpy()
            values[ids] = getattr(self._fresh, name, 0.0)  # MuJoCo 3.17 has no `plastic`
            field.assign(values)
        if self._drawn.shape[1]:
            first = self._full.plugin_stateadr[instance_of(self._full, self._task.figures.sands[0])]
            state = self._drawn[:, first : first + len(INITIAL)].astype(np.float32)
            self._sand.strength.assign(state[:, STRENGTH])
            self._sand.density.assign(state[:, DENSITY])
            self._sand.height.assign(state[:, HEIGHT])
        for name, values in self._numbers.items():
            attrgetter(name)(self._m).assign(values.astype(np.float32))
        mjw.forward(self._m, self._d)
        self._read(ids)

    def get_model(self, number: int) -> mujoco.MjModel:
        """Return the task's model, with the numbers of a world."""
        model = copy.copy(self._full)
        for name, values in self._numbers.items():
            attrgetter(name)(model)[:] = values[number]
        return model

    def get_data(self, number: int) -> mujoco.MjData:
        """Return the state of a world."""
        data = mujoco.MjData(self._full)
        for name in self._arrays.keys() & _STATE:
            getattr(data, name)[:] = self._arrays[name][number]
        return data

    def _steps(self, count: int) -> None:
        for _ in range(count):
            mjw.step(self._m, self._d)
        if "cfrc_ext" in self._arrays:
            mjw.rne_postconstraint(self._m, self._d)

    def _write(self) -> None:
        for name in self._arrays.keys() & _STATE:
            getattr(self._d, name).assign(self._arrays[name])

    def _read(self, ids: np.ndarray | None) -> None:
        """Read the bound arrays, of all worlds or of some."""
        rows = slice(None) if ids is None else ids
        for name, value in self._arrays.items():
            if name in ("ctrl", "plugin_state", "userdata"):
                continue
            found = getattr(self._d, name).numpy()
            if name == "sensordata":
                found = np.concatenate([found, self._figures()], axis=1)
            if name == "cfrc_ext":
                found = found + self._external()
            value[rows] = found.reshape(value.shape)[rows]

    def _figures(self) -> np.ndarray:
        """Return readings of the sand's sensors: force, depth, power and speed, shape (n, 6)."""
        sand = self._sand
        force, power = sand.force.numpy().sum(1), sand.power.numpy().sum(1)
        depth, speed = sand.depth.numpy().max(1), sand.speed.numpy().max(1)
        return np.column_stack([force, depth, power, speed])

    def _external(self) -> np.ndarray:
        """Return the sand's part of `cfrc_ext`: moments about the tree's center, and forces."""
        forces, moments = self._sand.force.numpy(), self._sand.moment.numpy()
        centres, trees = self._d.xipos.numpy(), self._d.subtree_com.numpy()
        wrenches = np.zeros((self._count, self._model.nbody, 6))
        for k, body in enumerate(self._rows):
            arm = centres[:, body] - trees[:, self._model.body_rootid[body]]
            wrenches[:, body, :3] = moments[:, k] + np.cross(arm, forces[:, k])
            wrenches[:, body, 3:] = forces[:, k]
        return wrenches
