"""`mjgranular view`: your own model on sand in a window."""

import math
import warnings
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import tyro

from mjgranular.cli.console import err
from mjgranular.cli.options import options_of
from mjgranular.engine import NAME, add_sand
from mjgranular.errors import FloorWarning, InputError
from mjgranular.experiment.drop import Drop, loading, make_ready, read, start_from
from mjgranular.experiment.ground import hide_replaced, refuse_floors
from mjgranular.picture.viewer import Switch, check_display, follow, opened
from mjgranular.picture.web import Page, check_address
from mjgranular.render.scenery import place_sun
from mjgranular.sand.prepare import fitted

_NOT_OPTIONS = ("model", "height", "velocity", "duration")


@dataclass(frozen=True, kw_only=True)
class ViewCommand(options_of(Drop, without=_NOT_OPTIONS)):
    """Your own MJCF model on sand in MuJoCo's viewer, in real time.

    Space pauses and resumes, Backspace restarts, a double click and Ctrl with the mouse pull at a
    body. The sand acts inside mj_step, by the plugin mjgranular.sand. A model that contains sand is
    shown with that.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
    draw: Annotated[
        tuple[Literal["forces", "depth"], ...], tyro.conf.arg(metavar="{forces,depth} ...")
    ] = ("forces",)
    """Arrows for the forces, dots for the elements in the sand, colored by depth."""
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0
    """Speed: 1 is real time, 0.1 a tenth of it."""
    duration: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time after which the window closes by itself [s]. Default: never."""
    web: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Serve a page for a browser instead, with pause, restart and speed; it needs no display."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of the page, by default for this computer and SSH tunnels to it."""

    def run(self) -> int:
        for name, value in (("speed", self.speed), ("duration", self.duration)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"the {name} must be positive and finite, got {value}")
        if self.web:
            check_address(self.host, self.port)
        elif (self.host, self.port) != (ViewCommand.host, ViewCommand.port):
            raise InputError("--host and --port are for a page: use --web")
        else:
            check_display()
        model = self.load()
        data, switch = mujoco.MjData(model), Switch(speed=self.speed)
        start_from(model, data, self.keyframe)
        if self.web:
            page = Page(model, data, switch, self.host, self.port)
            note = f"Open {page.address} in a browser. Ctrl-C ends it."
            shown: Any = closing(page)
        else:
            note = "Space: pause. Backspace: restart. Ctrl and mouse: pull a body."
            shown = opened(model, data, switch)
        with shown as viewer:
            err.print(note, style="dim")
            follow(viewer, model, data, switch, duration=self.duration)
        return 0

    def load(self) -> mujoco.MjModel:
        """Return the model with sand in it, in daylight."""
        drop = self.experiment(duration=1.0)  # not used
        with loading(drop.title), warnings.catch_warnings():
            spec = read(drop)
            if any(plugin.plugin_name == NAME for plugin in spec.plugins):
                err.print("The model contains sand, and is shown with that.", style="dim")
                return spec.compile()
            make_ready(spec, drop)
            bare = spec.compile()
            add_sand(spec, fitted(bare, drop.sand), draw=("surface", *self.draw))
            if not self.keep_floor:
                refuse_floors(bare, drop.sand)
            warnings.simplefilter("ignore", FloorWarning)
            model = spec.compile()
            hide_replaced(model, drop.sand)
            place_sun(model)
            return model
