"""Work of the sand on each body, from the velocities at the start and the end of each step."""

from __future__ import annotations

import mujoco
import numpy as np

from mjgranular.kernel import entry
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CVEL, SUBTREE_COM, XIPOS, floats, row_of, table_at
from mjgranular.kernel.motion import Motion, motion_along, read_motion, velocity_at
from mjgranular.kernel.records import bodies_of
from mjgranular.kernel.vector import dot, read_vector
from mjgranular.sand.sand import Sand


@compiled
def add_work(address, velocity, work, h):
    """Add the work of the last step's wrenches [J], and return the number of bodies.

    A constant force F turns the velocity v into v' and does the work h F (v + v') / 2, exactly the
    change of kinetic energy, for any step size. The power at the start or at the end of the step
    alone does not give that. `velocity` is the address of `qvel` at the end of the step; all else
    is from its start.
    """
    table = table_at(address)
    bodies = bodies_of(table)
    total = floats(work, len(bodies))
    for slot in range(len(bodies)):
        body = bodies[slot]
        begin = read_motion(row_of(table[CVEL], body.body, 6), 0)
        end = motion_along(table, body.last_dof, velocity, 1.0)
        both = Motion(begin.angular + end.angular, begin.linear + end.linear)
        com, tree = row_of(table[XIPOS], body.body, 3), row_of(table[SUBTREE_COM], body.root, 3)
        at_com = velocity_at(both, read_vector(com, 0) - read_vector(tree, 0))
        force, moment = read_vector(body.wrench, 0), read_vector(body.wrench, 3)
        power = dot(force, at_com) + dot(moment, both.angular)
        total[slot] += 0.5 * h * power
    return len(bodies)


class WorkMeter:
    """Counts the work of the sand on the bodies of a simulation that `Sand.step` advances."""

    def __init__(self, sand: Sand, data: mujoco.MjData) -> None:
        self._model, self._data = sand.model, data
        self._table = sand.table_of(data)
        self._add = entry(add_work, "int64(int64, int64, int64, float64)")
        self._work = np.zeros(len(np.unique(sand.elements["body"])))

    def add(self) -> None:
        """Add the work of a step. Call this after each `Sand.step`."""
        velocity = self._data.qvel.ctypes.data
        self._add(self._table, velocity, self._work.ctypes.data, self._model.opt.timestep)

    @property
    def work(self) -> np.ndarray:
        """Work of the sand on each body so far [J], in the order of the bodies' ids."""
        return self._work.copy()
