"""Films in notebooks."""

from __future__ import annotations

import importlib
from typing import Any


def show(film: Any, *, fps: int = 30, seconds: float = 5.0, camera: str | None = None) -> None:
    """Play a film where a notebook shows what a cell gives.

    Args:
        film: pictures, shape (height, width, 3), uint8, one by one or as an array; or the result of
            a run, of `mjgranular.experiment.run_drop` or `run_impact`, which is filmed.
        fps: frames a second.
        seconds: how long the film of a result lasts at least [s]; a run of a model that takes
            longer lasts as long as life.
        camera: of the model, for the film of a result; None for one that has all in view.

    Raises:
        InputError: no pictures, or neither pictures nor a result.
        MissingExtraError: a package for video is not installed; gives the install line.
        RenderError: MuJoCo cannot draw on this machine.
    """
    # Loaded when used: it stands above all that a simulation needs.
    importlib.import_module("mjgranular.picture.inline").play(
        film, fps=fps, seconds=seconds, camera=camera
    )
