"""`mjgranular studio`: the plugin file for MuJoCo Studio."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import mujoco

from mjgranular.errors import InputError


@dataclass(frozen=True)
class StudioCommand:
    """Print the path of the plugin file for MuJoCo Studio, which comes with MuJoCo 4.

    python -m mujoco.studio.viewer MODEL.xml --plugins="$(mjgranular studio)" loads the model with
    sand under it and has a panel for medium, law and surface.
    """

    def run(self) -> int:
        """Run the command."""
        if find_spec("mujoco.studio") is None:
            raise InputError(
                f"MuJoCo Studio comes with MuJoCo 4.0 and later, got {mujoco.__version__}"
            )
        from mjgranular.studio import PLUGIN

        print(PLUGIN)
        return 0
