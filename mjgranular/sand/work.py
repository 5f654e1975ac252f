"""Work of the sand on each body in a run, and the greatest force and depth: of every step."""

import mujoco
import numpy as np

from mjgranular.kernel import entry
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CVEL, SUBTREE_COM, XIPOS, floats, row_of, table_at
from mjgranular.kernel.motion import Motion, motion_along, read_motion, velocity_at
from mjgranular.kernel.records import bodies_of, contacts_of
from mjgranular.kernel.vector import dot, norm, read_vector
from mjgranular.sand.sand import Sand


@compiled
def add_work(address, velocity, totals, h):
    """Add the work of the last step's wrenches [J], and return the number of bodies.

    `totals` has a row for each of work, greatest force [N] and greatest depth [m].

    A constant force F turns the velocity v into v' and does the work h F (v + v') / 2, exactly the
    change of kinetic energy, for any step size. `velocity` is the address of `qvel` at the end of
    the step; all else is from its start.
    """
    table = table_at(address)
    bodies, contacts = bodies_of(table), contacts_of(table)
    count, first = len(bodies), 0
    total = floats(totals, 3 * count)
    for slot in range(count):
        body = bodies[slot]
        begin = read_motion(row_of(table[CVEL], body.body, 6), 0)
        end = motion_along(table, body.last_dof, velocity, 1.0)
        both = Motion(begin.angular + end.angular, begin.linear + end.linear)
        com, tree = row_of(table[XIPOS], body.body, 3), row_of(table[SUBTREE_COM], body.root, 3)
        at_com = velocity_at(both, read_vector(com, 0) - read_vector(tree, 0))
        force, moment = read_vector(body.wrench, 0), read_vector(body.wrench, 3)
        power = dot(force, at_com) + dot(moment, both.angular)
        total[slot] += 0.5 * h * power
        total[count + slot] = max(total[count + slot], norm(force))
        for i in range(first, body.end):
            total[2 * count + slot] = max(total[2 * count + slot], contacts[i].depth)
        first = body.end
    return len(bodies)


class WorkMeter:
    """Counts the work of the sand on the bodies of a simulation that `Sand.step` advances.

    Attributes:
        work: work of the sand on each body so far [J], in the order of the bodies' ids.
        force: greatest force on each body, over all steps [N].
        depth: greatest depth of each body at the start of a step [m]; minus infinity at first.
    """

    def __init__(self, sand: Sand, data: mujoco.MjData) -> None:
        self._model, self._data = sand.model, data
        self._table = sand.table_of(data)
        self._add = entry(add_work, "int64(int64, int64, int64, float64)")
        self._totals = np.zeros((3, len(np.unique(sand.elements["body"]))))
        self.work, self.force, self.depth = self._totals
        self.depth[:] = -np.inf

    def add(self) -> None:
        """Add the work of a step. Call this after each `Sand.step`."""
        velocity = self._data.qvel.ctypes.data
        self._add(self._table, velocity, self._totals.ctypes.data, self._model.opt.timestep)
