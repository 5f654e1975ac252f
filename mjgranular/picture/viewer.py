"""MuJoCo's interactive viewer: a check that it can open, and a real-time loop."""

import importlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import mujoco

from mjgranular._util.display import opens_window
from mjgranular.errors import RenderError

FRAME = 1 / 60  # time from one frame to the next [s]
_WORK = 0.8 * FRAME  # at most this much of it for steps [s]; chosen, not measured
_LATE = 0.1  # a simulation this far behind the clock does not catch up [s]; chosen
_SPACE, _ENTER = 32, 257  # GLFW's numbers of keys
_UP, _DOWN, _LEFT, _RIGHT, _DOT, _SLASH = 265, 264, 263, 262, 46, 47
_CHANGES = {  # of a command, by key; chosen: MuJoCo's viewer has other uses for other keys
    _UP: (0, 0.1), _DOWN: (0, -0.1), _DOT: (1, 0.1), _SLASH: (1, -0.1), _LEFT: (2, 0.2),
    _RIGHT: (2, -0.2),
}  # fmt: skip
_FILM = "--web serves a page, and `mjgranular drop MODEL.xml --out DIR --video` films a run"


@dataclass
class Command:
    """The velocity that a robot is to have, within `limits`, by the names in `PARTS`."""

    PARTS = "ahead [m/s]", "to the left [m/s]", "yaw to the left [rad/s]"

    limits: Sequence[tuple[float, float]]
    values: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def press(self, key: int) -> None:
        if key == _ENTER:
            self.values[:] = 0.0, 0.0, 0.0
        elif key in _CHANGES:
            part, change = _CHANGES[key]
            low, high = self.limits[part]
            self.values[part] = min(max(round(self.values[part] + change, 3), low), high)


@dataclass
class Switch:
    """What the user changes while a simulation runs."""

    held: bool = False  # whether it is paused
    speed: float = 1.0  # simulated time over real time
    command: Command | None = None  # of a robot that follows one

    def press(self, key: int) -> None:
        if key == _SPACE:
            self.held = not self.held
        elif self.command is not None:
            self.command.press(key)


def check_display() -> None:
    """Check that a window can be opened: without one MuJoCo's viewer waits forever."""
    # On macOS windows belong to mjpython's thread, and MuJoCo says so itself.
    if sys.platform != "darwin" and not opens_window():
        raise RenderError(
            f"no window can be opened here, DISPLAY is {os.environ.get('DISPLAY')!r}; {_FILM}"
        )


class Window:
    """MuJoCo's viewer, with the command written into it."""

    def __init__(self, handle: Any, command: Command | None) -> None:
        self._handle, self._command, self._written = handle, command, ""
        self.lock, self.is_running = handle.lock, handle.is_running

    def sync(self) -> None:
        if self._command is not None:
            values = "\n".join(f"{value:.2f}" for value in self._command.values)
            if values != self._written:
                self._written = values
                self._handle.set_texts((None, None, "\n".join(Command.PARTS), values))
        self._handle.sync()


@contextmanager
def opened(
    model: mujoco.MjModel, data: mujoco.MjData, switch: Switch, camera: Mapping[str, Any]
) -> Iterator[Window]:
    """Open MuJoCo's viewer, and close it at the end.

    The camera follows the body `trackbodyid`, if there is one among the settings, as in Gymnasium.
    """
    others, panels = set(threading.enumerate()), switch.command is None
    try:
        viewer: Any = importlib.import_module("mujoco.viewer")
        handle = viewer.launch_passive(
            model, data, key_callback=switch.press, show_left_ui=panels, show_right_ui=panels
        )
    except (ImportError, RuntimeError) as error:
        raise RenderError(f"MuJoCo's viewer does not open: {error}") from None
    try:
        with handle:
            if "trackbodyid" in camera:
                handle.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
                for name in ("trackbodyid", "distance", "azimuth", "elevation"):
                    setattr(handle.cam, name, camera.get(name, getattr(handle.cam, name)))
            yield Window(handle, switch.command)
    finally:  # its thread still cleans up, and must finish before the process ends
        for thread in set(threading.enumerate()) - others:
            thread.join(timeout=5.0)


def follow(
    viewer: Any,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    switch: Switch,
    *,
    duration: float | None = None,
    step: Callable[[], None] | None = None,
    restart: Callable[[], None] = lambda: None,
) -> None:
    """Step a simulation in real time, and show it, until the viewer is closed.

    If steps are slower than real time, the simulation slows down, and stays responsive. The viewer
    is a `Window` or a `web.Page`; `duration` is the time after which to end [s].
    `step` is called in place of `mj_step`, and `restart` after the user has reset the simulation.
    """
    step = step or partial(mujoco.mj_step, model, data)
    opening = start = time.perf_counter()
    begin = last = data.time
    speed = switch.speed
    while viewer.is_running():
        now = time.perf_counter()
        if duration is not None and now - opening > duration:
            return
        with viewer.lock():
            if data.time < last:
                restart()
            late = begin + speed * (now - start) - data.time > speed * _LATE
            if switch.held or late or data.time < last or speed != switch.speed:  # < last: reset
                start, begin, speed = now, data.time, switch.speed
            if switch.held:
                mujoco.mj_forward(model, data)  # shows perturbations while paused
            else:
                goal = begin + speed * (now - start)
                while data.time <= goal and time.perf_counter() - now < _WORK:
                    step()
            last = data.time
        viewer.sync()
        time.sleep(max(0.0, now + FRAME - time.perf_counter()))
