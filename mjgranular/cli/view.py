"""`mjgranular view`: a model of one's own on sand, to look at and to push about."""

from __future__ import annotations

import importlib
import math
import os
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import tyro

from mjgranular.cli.console import err
from mjgranular.engine import NAME, add_sand
from mjgranular.errors import GranularError, InputError, RenderError, UnknownNameError
from mjgranular.experiment.drop import Drop
from mjgranular.experiment.scenery import add_bed
from mjgranular.surface import Plane, Surface

FRAME = 1 / 60
"""From one picture to the next [s]."""

_WORK = 0.8 * FRAME  # of it at most for steps [s]; chosen, not measured
_LATE = 0.1  # so far behind the clock, a simulation is not asked to catch up [s]; chosen
_FINE_STEP = 1e-4  # largest of the explicit scheme that is left to us [s], as in `Drop`; chosen
_SPACE = 32  # GLFW's number of the key
_FILM = "`mjgranular drop MODEL.xml --out DIR --video` films a run without one"


@dataclass(frozen=True)
class ViewCommand:
    """Your own MJCF model on sand in MuJoCo's viewer, at the speed of life.

    Space holds it and lets it go on, Backspace begins anew, a double click and Ctrl with the mouse
    pull at a body. The sand acts inside mj_step, by the plugin mjgranular.sand.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
    medium: Annotated[str, tyro.conf.arg(metavar="NAME")] = "quikrete_medium"
    """The sand, or a YAML file; `mjgranular media` lists what there is."""
    law: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The force law; `mjgranular laws` lists what there is. Default: the medium's own."""
    scheme: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto"
    """How forces become a step."""
    surface_height: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """Height of the surface above the world's origin [m]."""
    slope: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Slope of the surface [degrees]."""
    uphill: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Direction of steepest ascent from the x axis [degrees]."""
    bed: Annotated[str | None, tyro.conf.arg(metavar="GEOM")] = None
    """Box geom of the model that is the sand."""
    height_field: Annotated[str | None, tyro.conf.arg(metavar="GEOM")] = None
    """Hfield geom of the model that is the sand."""
    instead_of: Annotated[tuple[str, ...], tyro.conf.arg(metavar="GEOM ...")] = ()
    """Geoms that are taken out of the model, such as a floor that would carry it above the sand."""
    bodies: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Bodies that meet the sand. Default: all that can move."""
    geoms: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Geoms that meet the sand."""
    groups: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N ...")] = ()
    """Geom groups whose collision geoms meet the sand."""
    keyframe: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Keyframe of the model to start from."""
    timestep: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time step [s]. Default: the model's, at most 1e-4 s with the explicit scheme."""
    resolution: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How finely geoms are cut into elements. Default: the law's."""
    draw: Annotated[
        tuple[Literal["forces", "depth"], ...], tyro.conf.arg(metavar="{forces,depth} ...")
    ] = ("forces",)
    """Arrows for the forces, dots for the elements in the sand, coloured by depth."""
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0
    """How fast: 0.1 is ten times slower than life."""
    duration: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time after which the window closes by itself [s]. Default: never."""

    def run(self) -> int:
        """Runs the command."""
        if not (math.isfinite(self.speed) and self.speed > 0):
            raise InputError(f"the speed must be positive and finite, not {self.speed}")
        check_display()
        model = self.load()
        data = mujoco.MjData(model)
        if self.keyframe is not None:
            key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, self.keyframe)
            if key < 0:
                known = [model.key(k).name for k in range(model.nkey)]
                raise UnknownNameError("keyframe of the model", self.keyframe, known)
            mujoco.mj_resetDataKeyframe(model, data, key)
        switch = Switch()
        with opened(model, data, switch) as viewer:
            err.print("Space: hold. Backspace: anew. Ctrl and mouse: pull at a body.", style="dim")
            follow(viewer, model, data, switch, speed=self.speed, duration=self.duration)
        return 0

    def load(self) -> mujoco.MjModel:
        """The model with sand in it, and a visible bed if it has none.

        Raises:
            InputError: MuJoCo cannot load it, or the sand does not fit it.
            UnknownNameError: it lacks a geom that is to be taken out.
        """
        drop = Drop(
            model=self.model,
            surface_height=self.surface_height,
            slope=math.radians(self.slope),
            uphill=math.radians(self.uphill),
            bed=self.bed,
            height_field=self.height_field,
            timestep=self.timestep,
        )
        name = self.model.name
        try:
            spec = mujoco.MjSpec.from_file(str(self.model))
            self._take_out(spec)
            if self.timestep is not None:
                spec.option.timestep = self.timestep
            elif self.scheme == "explicit":
                spec.option.timestep = min(spec.option.timestep, _FINE_STEP)
            if any(plugin.plugin_name == NAME for plugin in spec.plugins):
                err.print("The model has sand of its own, and is shown with that.", style="dim")
            else:
                self._add(spec, drop.surface)
            return spec.compile()
        except (ValueError, OSError, mujoco.FatalError) as error:
            if isinstance(error, GranularError):
                raise
            reason = " ".join(str(error).split())
            _, ours, fault = reason.partition("engine error: mjgranular ")
            raise InputError(fault if ours else f"MuJoCo cannot load {name}: {reason}") from None

    def _add(self, spec: mujoco.MjSpec, surface: Surface) -> None:
        if isinstance(surface, Plane):
            add_bed(spec, surface)
        add_sand(
            spec,
            medium=self.medium,
            law=self.law,
            surface=surface,
            scheme=self.scheme,
            bodies=self.bodies or None,
            geoms=self.geoms or None,
            groups=self.groups or None,
            resolution=self.resolution,
            draw=self.draw,
        )

    def _take_out(self, spec: mujoco.MjSpec) -> None:
        for name in self.instead_of:
            geom = spec.geom(name)
            if geom is None:
                known = [geom.name for geom in spec.geoms if geom.name]
                raise UnknownNameError("geom of the model", name, known)
            spec.delete(geom)


class Switch:
    """Whether the simulation is held; turned by a key."""

    def __init__(self) -> None:
        self.held = False

    def press(self, key: int) -> None:
        """What a key does."""
        if key == _SPACE:
            self.held = not self.held


def check_display() -> None:
    """Makes sure that a window can be opened: without one MuJoCo's viewer waits for ever.

    Raises:
        RenderError: it cannot.
    """
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not shown:
        raise RenderError(f"there is no display to open a window on (DISPLAY is not set); {_FILM}")
    if sys.platform == "darwin":
        return  # windows belong to mjpython's thread, and MuJoCo says so itself
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        opens = _opens_a_window()
    if not opens:
        reasons = [str(warning.message) for warning in told]
        reason = f" ({reasons[-1]})" if reasons else ""
        raise RenderError(f"no window can be opened on this display{reason}; {_FILM}")


def _opens_a_window() -> bool:
    try:
        glfw: Any = importlib.import_module("glfw")
    except ImportError as error:
        warnings.warn(str(error), stacklevel=2)
        return False
    if not glfw.init():
        return False
    glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
    window = glfw.create_window(64, 64, "mjgranular", None, None)
    if window:
        glfw.destroy_window(window)
    glfw.terminate()
    return bool(window)


@contextmanager
def opened(model: mujoco.MjModel, data: mujoco.MjData, switch: Switch) -> Iterator[Any]:
    """MuJoCo's viewer, closed at the end.

    Raises:
        RenderError: it does not open.
    """
    try:
        viewer: Any = importlib.import_module("mujoco.viewer")
        others = set(threading.enumerate())
        handle = viewer.launch_passive(model, data, key_callback=switch.press)
    except (ImportError, RuntimeError) as error:
        raise RenderError(f"MuJoCo's viewer does not open: {error}") from None
    try:
        with handle:
            yield handle
    finally:  # its thread still clears up, and must be through before the process ends
        for thread in set(threading.enumerate()) - others:
            thread.join(timeout=5.0)


def follow(
    viewer: Any,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    switch: Switch,
    *,
    speed: float,
    duration: float | None,
) -> None:
    """Steps a simulation as the clock goes, and shows it, until the viewer is closed.

    Args:
        viewer: as `mujoco.viewer.launch_passive` returns it.
        model: the model.
        data: its data.
        switch: whether it is held.
        speed: simulated time over time.
        duration: time after which to end [s]; None for never.
    """
    opening = start = time.perf_counter()
    begin = last = data.time
    while viewer.is_running():
        now = time.perf_counter()
        if duration is not None and now - opening > duration:
            return
        with viewer.lock():
            late = begin + speed * (now - start) - data.time > speed * _LATE
            if switch.held or late or data.time < last:  # the last: it has begun anew
                start, begin = now, data.time
            if switch.held:
                mujoco.mj_forward(model, data)
            else:
                goal = begin + speed * (now - start)
                while data.time <= goal and time.perf_counter() - now < _WORK:
                    mujoco.mj_step(model, data)
            last = data.time
        viewer.sync()
        time.sleep(max(0.0, now + FRAME - time.perf_counter()))
