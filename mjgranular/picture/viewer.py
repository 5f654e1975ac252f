"""MuJoCo's interactive viewer: a check that it can open, and a real-time loop."""

import importlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco

from mjgranular._util.window import opens_window
from mjgranular.errors import RenderError

FRAME = 1 / 60
"""Time from one frame to the next [s]."""

_WORK = 0.8 * FRAME  # at most this much of it for steps [s]; chosen, not measured
_LATE = 0.1  # a simulation this far behind the clock does not catch up [s]; chosen
_SPACE = 32  # GLFW's number of the key
_FILM = "`mjgranular drop MODEL.xml --out DIR --video` films a run without one"


@dataclass
class Switch:
    """What the user changes while a simulation runs."""

    held: bool = False  # whether it is paused
    speed: float = 1.0  # simulated time over real time

    def press(self, key: int) -> None:
        """React to a key."""
        if key == _SPACE:
            self.held = not self.held


def check_display() -> None:
    """Check that a window can be opened: without one MuJoCo's viewer waits forever."""
    # On macOS windows belong to mjpython's thread, and MuJoCo says so itself.
    if sys.platform != "darwin" and not opens_window():
        raise RenderError(
            f"no window can be opened here, DISPLAY is {os.environ.get('DISPLAY')!r}; {_FILM}"
        )


@contextmanager
def opened(model: mujoco.MjModel, data: mujoco.MjData, switch: Switch) -> Iterator[Any]:
    """Open MuJoCo's viewer, and close it at the end."""
    others = set(threading.enumerate())
    try:
        viewer: Any = importlib.import_module("mujoco.viewer")
        handle = viewer.launch_passive(model, data, key_callback=switch.press)
    except (ImportError, RuntimeError) as error:
        raise RenderError(f"MuJoCo's viewer does not open: {error}") from None
    try:
        with handle:
            yield handle
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
) -> None:
    """Step a simulation in real time, and show it, until the viewer is closed.

    If steps are slower than real time, the simulation slows down, and stays responsive. The viewer
    is a handle from `mujoco.viewer.launch_passive`; `duration` is the time after which to end [s].
    """
    opening = start = time.perf_counter()
    begin = last = data.time
    speed = switch.speed
    while viewer.is_running():
        now = time.perf_counter()
        if duration is not None and now - opening > duration:
            return
        with viewer.lock():
            late = begin + speed * (now - start) - data.time > speed * _LATE
            if switch.held or late or data.time < last or speed != switch.speed:  # < last: reset
                start, begin, speed = now, data.time, switch.speed
            if switch.held:
                mujoco.mj_forward(model, data)  # shows perturbations while paused
            else:
                goal = begin + speed * (now - start)
                while data.time <= goal and time.perf_counter() - now < _WORK:
                    mujoco.mj_step(model, data)
            last = data.time
        viewer.sync()
        time.sleep(max(0.0, now + FRAME - time.perf_counter()))
