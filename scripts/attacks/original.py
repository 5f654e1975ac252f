"""A model as it was before anything was changed under way."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

# Of the model, what events change.
_FIELDS = (
    "dof_damping", "dof_armature", "dof_frictionloss", "jnt_stiffness", "body_mass", "body_inertia",
    "body_ipos", "body_pos", "geom_size", "geom_pos", "geom_friction", "hfield_data", "eq_data",
    "tendon_damping", "tendon_stiffness", "actuator_gainprm", "actuator_biasprm",
)  # fmt: skip
_OPTIONS = (
    "timestep", "impratio", "tolerance", "ls_tolerance", "noslip_tolerance", "gravity", "wind",
    "density", "viscosity", "integrator", "cone", "jacobian", "solver", "iterations",
    "ls_iterations", "noslip_iterations", "disableflags", "enableflags",
)  # fmt: skip


class Original:
    """The fields and options that events change."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._fields = {name: np.copy(getattr(model, name)) for name in _FIELDS}
        self._options: dict[str, Any] = {}
        for name in _OPTIONS:
            value = getattr(model.opt, name)
            self._options[name] = np.copy(value) if isinstance(value, np.ndarray) else value

    def restore(self, model: mujoco.MjModel) -> None:
        """Makes a model what it was."""
        for name, values in self._fields.items():
            getattr(model, name)[:] = values
        for name, value in self._options.items():
            setattr(model.opt, name, value)
