"""Metrics of the sand, read from sensors: the same for one simulation and for many."""

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.engine.instances import sands_in
from mjgranular.engine.sensor import SandReadings
from mjgranular.law.validity import found_at
from mjgranular.sand import SandSpec
from mjgranular.sand.prepare import geoms_in_sand
from mjgranular.sand.spec import material_of
from mjgranular.surface import surface_of
from mjgranular.surface.place import strength_of_gravity

BAD = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""Warnings of MuJoCo that a simulation has diverged; most likely it has been reset then."""


class Figures:
    """Reads the sensors that `put_on_sand` has added, or `readings` that stand in for them.

    `sands` are the names of the instances, `gravity` is that of the model [m/s^2], shape (3,).
    """

    def __init__(
        self, model: mujoco.MjModel, sands: Sequence[SandSpec], readings: SandReadings | None = None
    ) -> None:
        self.sands = names = sands_in(model)
        # Where the readings of each sand begin: force, depth, power, speed.
        sensors = [int(model.sensor(f"sand/force/{name}").adr[0]) for name in names if not readings]
        self._blocks = readings.together if readings else sensors
        self.gravity = model.opt.gravity.copy()
        limits, self._found = zip(*(_limits_of(model, sand) for sand in sands), strict=True)
        self._limits = np.array(limits)
        pull = strength_of_gravity(model)
        width = self._limits[:, 0]
        self._limits[:, 0] = 1 / np.sqrt(pull * width) if pull else 0 * width  # Froude of 1 m/s
        self._only = self._limits[0].tolist()  # numbers are faster than arrays

    def read(
        self, readings: np.ndarray, active: np.ndarray | int = 0, slope: np.ndarray | float = 0.0
    ) -> dict[str, np.ndarray]:
        """Return the sand's metrics of n simulations.

        They are those of the last substep. The Froude number is |v| / sqrt(g w) with the largest
        speed in the sand and the smallest width of a geom that meets it: an upper bound. Whether
        the law is valid follows from it, depth over that width and slope, not the grains' inertia.

        Of `sensordata` of shape (n, nsensordata), the index of the active sand, and the slope of
        the ground in addition to that of its surface [rad], each of shape (n,), return the entries
        of `info` that docs/environments.md has in a table. Sensors of other sands read zero.
        """
        first, *others = self._blocks
        block = readings[:, first : first + 6].copy()  # not a view of MuJoCo's array
        for other in others:
            block += readings[:, other : other + 6]
        per_speed, *most = self._limits[active].T if others else self._only
        depth, speed = block[:, 3], block[:, 5]
        froude = speed * per_speed
        valid = (froude <= most[0]) & (depth <= most[1]) & (np.abs(slope) <= most[2])
        return {
            "sand/force": block[:, :3],
            "sand/depth": depth,
            "sand/power": block[:, 4],
            "sand/froude": froude,
            "sand/valid": valid,
            "sand/error": self._errors(active, froude) * (depth > 0),
        }

    def _errors(self, active: np.ndarray | int, froude: np.ndarray) -> np.ndarray:
        """Return the measured errors at Froude numbers, for the active sand; shape (n,)."""
        if len(self._found) == 1:
            bounds, errors = self._found[0]
            return errors[bounds.searchsorted(froude)]
        error = np.ones(froude.shape)
        for sand, (bounds, errors) in enumerate(self._found):
            mine = np.broadcast_to(np.asarray(active) == sand, froude.shape)
            error[mine] = errors[bounds.searchsorted(froude[mine])]
        return error


def _limits_of(
    model: mujoco.MjModel, sand: SandSpec
) -> tuple[list[float], tuple[np.ndarray, np.ndarray]]:
    """Return limits of a sand's law in a model, and the law's errors.

    The first are the smallest width of an element [m], and the largest Froude number, depth [m] and
    slope [rad]; the second upper Froude numbers, and errors, with one more, 1, beyond.
    """
    medium, law = material_of(model, sand)
    elements = law.elements(model, geoms_in_sand(model, sand), sand.resolution)
    width = float(elements["width"].min())
    froude, depth, slope = (
        min((v.most for v in law.validity if v.measure == measure), default=math.inf)
        for measure in ("froude", "depth_over_width", "slope")
    )
    limits = [width, froude, depth * width, slope - surface_of(sand.surface).tilt(model)]
    grains = medium.grain and width / medium.grain.value
    bounds = sorted({finding.froude for finding in law.findings})
    found = [found_at(law.findings, bound, grains) for bound in bounds]
    errors = [1.0 if one is None else min(one.error, 1.0) for one in found]
    return limits, (np.array(bounds), np.array([*errors, 1.0]))
