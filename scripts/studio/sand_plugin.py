"""MuJoCo Studio's plugin: sand under every model that is loaded, and a panel for it.

Two halves, as Studio has them: `SandScene` runs beside the simulation and loads models,
`SandPanel` is a window of the viewer. They send each other `SandWanted` and `SandFelt`.
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

from mjgranular import GranularError, Plane, SandSpec, media
from mjgranular.engine import NAME, add_sand
from mjgranular.engine.instances import sands_in
from mjgranular.engine.readings import SandReadings
from mjgranular.experiment.ground import hide_replaced
from mjgranular.render.scenery import add_scenery, place_sun
from mjgranular.sand.chosen import geoms_in_sand
from mjgranular.sand.prepare import fitted
from mjgranular.sand.spec import combined
from mjgranular.surface.floors import find_floors

_MODELS = (".xml", ".urdf")  # others are loaded as they are
_DEFAULT = "default"
_logger = logging.getLogger(__name__)  # Studio's console shows it


@dataclass(frozen=True)
class SandWanted(messages.Event):
    """The sand that the panel asks for.

    Attributes:
        medium: its name; None for one that follows from law and bodies.
        law: in words, as `SandSpec` has it; None for the medium's own.
        height: of the surface [m].
        slope: of the surface [rad].
        memory: side of the cells on which the sand remembers what has been pressed down [m]; 0 for
            sand that closes behind what has passed.
        on: whether there is to be any.
    """

    medium: str | None = None
    law: str | None = None
    height: float = 0.0
    slope: float = 0.0
    memory: float = 0.0
    on: bool = True


@dataclass(frozen=True)
class SandFelt(messages.Snapshot):
    """What the sand does now.

    Attributes:
        what: which sand it is, or why there is none.
        force: of all sands on the bodies [N], world axes.
        depth: of the deepest element [m].
        power: of the sand on the bodies [W].
    """

    what: str
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    depth: float = 0.0
    power: float = 0.0


def sandy(path: Path, wanted: SandWanted) -> tuple[mujoco.MjModel, str]:
    """A model with sand in it, in the place of ground that would carry it, and what sand that is.

    A model that has sand of its own is left as it is.

    Raises:
        GranularError: the sand does not fit the model.
        ValueError: MuJoCo cannot load the model.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    if any(one.plugin_name == NAME for one in spec.plugins):
        return spec.compile(), "the model has sand of its own"
    surface = Plane(height=wanted.height, slope=wanted.slope)
    sand = SandSpec(
        medium=wanted.medium, law=wanted.law, surface=surface, memory=wanted.memory or None
    )
    bare = spec.copy().compile()
    sand = fitted(bare, sand)
    floors = find_floors(bare, geoms_in_sand(bare, sand), surface)
    sand = combined(sand, {"instead_of": floors or None})
    add_scenery(spec, surface)
    add_sand(spec, sand, draw=("surface", "forces"))
    model = spec.compile()
    hide_replaced(model, sand)
    place_sun(model)
    names = ", ".join(bare.geom(floor).name or f"geom {floor}" for floor in floors)
    return model, f"sand instead of {names}" if floors else "sand"


class SandScene(plugin.SimPlugin):
    """Loads models with sand in them."""

    def __init__(self) -> None:
        self._wanted = SandWanted()
        self._what = "no model"
        self._readings: SandReadings | None = None

    @messages.handler
    def on_sand_wanted(self, event: SandWanted) -> None:
        """Loads the model anew with another sand."""
        self._wanted = event
        self.handle.reload()

    @messages.handler
    def on_load_model(self, event: messages.LoadModelEvent) -> bool:
        """Loads a model; what cannot have sand is left to Studio."""
        path = Path(event.path or self.handle.model_path)
        if path.suffix.lower() not in _MODELS or not self._wanted.on:
            self._what = "no sand"
            return False
        try:
            model, self._what = sandy(path, self._wanted)
        except (GranularError, ValueError) as error:
            self._what = f"no sand: {' '.join(str(error).split())}"
            _logger.warning("%s: %s", path.name, self._what)
            return False
        self.handle.set_model(model, path=str(path))
        return True

    @messages.handler
    def on_model(self, event: messages.PostModelEvent) -> None:
        """Finds the sands of another model."""
        sands = sands_in(event.model)
        self._readings = SandReadings(event.model, sands) if sands else None

    @messages.handler
    def on_post_step(self, event: messages.PostStepEvent) -> None:
        """Tells the panel what the sand does."""
        if self._readings is None:
            self.handle.send_to_viewer(SandFelt(self._what))
            return
        read = self._readings.read(event.data).reshape(-1, 6)
        force = tuple(read[:, :3].sum(axis=0).tolist())
        depth, power = float(read[:, 3].max()), float(read[:, 4].sum())
        self.handle.send_to_viewer(SandFelt(self._what, force, depth, power))


class SandPanel(plugin.ViewerPlugin):
    """Window with the sand: what it is to be, and what it does."""

    def __init__(self) -> None:
        self._media = [_DEFAULT, *media]
        self._medium = 0
        self._law = ""
        self._height, self._slope = 0.0, 0.0  # [m], [degrees]
        self._memory, self._cell = False, 0.01  # [m]
        self._on = True
        self._felt = SandFelt("no model")

    @messages.handler
    def on_sand_felt(self, snapshot: SandFelt) -> None:
        """Keeps the newest numbers."""
        self._felt = snapshot

    def wanted(self) -> SandWanted:
        """The sand that the fields of the panel describe."""
        return SandWanted(
            medium=self._media[self._medium] if self._medium else None,
            law=self._law.strip() or None,
            height=self._height,
            slope=math.radians(self._slope),
            memory=self._cell if self._memory else 0.0,
            on=self._on,
        )

    @messages.handler
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        """Draws the window."""
        if imgui.Begin("Sand")[0]:
            _, self._on = imgui.Checkbox("sand", self._on)
            _, self._medium = imgui.Combo("medium", self._medium, self._media)
            _, self._law = imgui.InputText("law", self._law)
            _, self._height = imgui.InputFloat("height [m]", self._height, 0.01, 0.1)
            _, self._slope = imgui.InputFloat("slope [degrees]", self._slope, 1.0, 5.0)
            _, self._memory = imgui.Checkbox("memory", self._memory)
            _, self._cell = imgui.InputFloat("cell [m]", self._cell, 0.001, 0.01)
            if imgui.Button("Load with this sand"):
                self.viewer.send_to_sim(self.wanted())
            imgui.SeparatorText("now")
            imgui.TextWrapped(self._felt.what)
            imgui.TextUnformatted(f"force  {np.linalg.norm(self._felt.force):9.3g} N")
            imgui.TextUnformatted(f"depth  {1e3 * self._felt.depth:9.3g} mm")
            imgui.TextUnformatted(f"power  {self._felt.power:9.3g} W")
        imgui.End()
