"""Films in notebooks."""

import importlib
from typing import Any


def show(film: Any, *, fps: int = 30, seconds: float = 5.0, camera: str | None = None) -> None:
    """Play a film in the output of a notebook cell.

    Args:
        film: pictures, shape (height, width, 3), uint8, one by one or as an array; or the result of
            `mjgranular.experiment.run_drop` or `run_impact`, which is filmed.
        fps: frames per second.
        seconds: least duration of the film of a result [s]; longer runs are filmed in real time.
        camera: camera of the model, for the film of a result; None for one that shows everything.

    Raises:
        InputError: no pictures, or neither pictures nor a result.
        MissingExtraError: a package for video is not installed; gives the install line.
        RenderError: MuJoCo cannot render on this machine.
    """
    # Imported when used: it depends on packages that import this one.
    importlib.import_module("mjgranular.picture.video").play(film, fps, seconds, camera)
