"""`mjgranular view`: a model of one's own on sand, to look at and to pull at."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import mujoco
import tyro

from mjgranular.cli.console import err
from mjgranular.engine import NAME, add_sand
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment.drop import LARGEST_STEP, Drop, start_from
from mjgranular.experiment.ground import refuse_floors, take_out
from mjgranular.experiment.scenery import add_bed
from mjgranular.picture.viewer import Switch, check_display, follow, opened
from mjgranular.reading import check_regular
from mjgranular.surface import Plane, Surface


@dataclass(frozen=True)
class ViewCommand:
    """Your own MJCF model on sand in MuJoCo's viewer, at the speed of life.

    Space holds it and lets it go on, Backspace begins anew, a double click and Ctrl with the mouse
    pull at a body. The sand acts inside mj_step, by the plugin mjgranular.sand. A model that has
    sand of its own is shown with that.
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
    keep_floor: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Let the model stand on ground of its own at or above the surface of the sand."""
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
        for name, value in (("speed", self.speed), ("duration", self.duration)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"the {name} must be positive and finite, not {value}")
        check_display()
        model = self.load()
        data = mujoco.MjData(model)
        start_from(model, data, self.keyframe)
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
        check_regular(self.model, "the model")
        try:
            spec = mujoco.MjSpec.from_file(str(self.model))
            take_out(spec, self.instead_of)
            if self.timestep is not None:
                spec.option.timestep = self.timestep
            elif self.scheme == "explicit":
                spec.option.timestep = min(spec.option.timestep, LARGEST_STEP)
            if any(plugin.plugin_name == NAME for plugin in spec.plugins):
                err.print("The model has sand of its own, and is shown with that.", style="dim")
            else:
                self._add(spec, drop.surface)
            return spec.compile()
        except (ValueError, OSError, mujoco.FatalError) as error:
            if isinstance(error, GranularError):
                raise
            reason = " ".join(str(error).split())
            ours = re.search("engine error: mjgranular '[^']*': (.*)", reason)
            fault = ours[1] if ours else f"MuJoCo cannot load {name}: {reason}"
            raise InputError(fault) from None

    def _add(self, spec: mujoco.MjSpec, surface: Surface) -> None:
        bare = spec.compile()
        if isinstance(surface, Plane) and not self.keep_floor:
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
        if not self.keep_floor:
            refuse_floors(bare, surface, bodies=self.bodies, geoms=self.geoms, groups=self.groups)
