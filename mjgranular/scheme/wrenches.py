"""Parts of every scheme's program: poses of bodies, and `xfrc_applied`."""

import math

import mujoco

from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.motion import read_motion
from mjgranular.kernel.records import NO_GRAVITY, bodies_of, options_at
from mjgranular.kernel.vector import read_matrix, read_vector
from mjgranular.law.kernel import Pose


@compiled
def place_of(table, body):
    """Return the addresses of the pose of a body in the sand, for `pose_at`."""
    number = body.body
    return (
        table[memory.XPOS] + 24 * number,
        table[memory.XMAT] + 72 * number,
        table[memory.XIPOS] + 24 * number,
        table[memory.SUBTREE_COM] + 24 * body.root,
        table[memory.CVEL] + 48 * number,
    )


@compiled
def pose_at(place):
    """Read pose and motion of a body in the sand, from `place_of`.

    In a loop over elements, call it for each of them: then values that an element does not need are
    not read, and none have to be kept during a call of the law.
    """
    return Pose(
        read_vector(memory.floats(place[0], 3), 0),
        read_matrix(memory.floats(place[1], 9), 0),
        read_vector(memory.floats(place[2], 3), 0),
        read_vector(memory.floats(place[3], 3), 0),
        read_motion(memory.floats(place[4], 6), 0),
    )


@compiled
def gravity_of(table):
    """Return the magnitude of gravity [m/s^2]; 0 if the model disables gravity."""
    options = options_at(table)
    if options.disableflags & NO_GRAVITY != 0:
        return 0.0
    g = options.gravity
    return math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])


@compiled
def row_of_body(table, body):
    """Return a body's row of `xfrc_applied`; and whether it holds what the last call wrote."""
    first, untouched = 6 * body.body, True
    row = memory.floats(table[memory.XFRC], 6 * table[memory.NBODY])[first : first + 6]
    for k in range(6):
        untouched = untouched and row[k] == body.last_wrench[k]
    return row, untouched


@compiled
def find_bad_wrench(table):
    """Return the row in `bodies` of the first wrench that is not finite, or -1.

    Inside MuJoCo's step the table has no `xfrc_applied`, and MuJoCo finds it.
    """
    bodies = bodies_of(table)
    for slot in range(len(bodies) if table[memory.XFRC] != 0 else 0):
        total = 0.0
        for k in range(6):
            total += bodies[slot].wrench[k]
        if not math.isfinite(total):
            return slot
    return -1


@compiled
def add_wrenches(table):
    """Add the bodies' finite wrenches to `xfrc_applied`, and remove those of the last call.

    A row that still holds what the last call wrote is first restored to its value before that call.
    A row that does not has been written by the user since (or reset, or copied), and is taken as
    the user's. Inside MuJoCo's step the table has no `xfrc_applied`, and nothing is done.
    """
    bodies = bodies_of(table)
    for slot in range(len(bodies) if table[memory.XFRC] != 0 else 0):
        body = bodies[slot]
        row, untouched = row_of_body(table, body)
        for k in range(6):
            if not untouched:
                body.user_wrench[k] = row[k]
            row[k] = body.user_wrench[k] + body.wrench[k]
            body.last_wrench[k] = row[k]


_BAD = tuple(
    2 * int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")
)


@compiled
def is_bad(table):
    """Return True if MuJoCo found NaN, infinite or huge numbers in the state and reset it.

    Inside MuJoCo's step, which deals with that itself, the table has no warnings.
    """
    if table[memory.WARNINGS] == 0:
        return False
    # mjWarningStat is {int lastinfo; int number;}: the address is that of the first number.
    numbers = memory.ints(table[memory.WARNINGS], _BAD[2] + 1)
    return numbers[_BAD[0]] + numbers[_BAD[1]] + numbers[_BAD[2]] > 0


@compiled
def withdraw_wrenches(table):
    """Remove the sand's wrenches from rows of `xfrc_applied` that still hold them.

    Inside MuJoCo's step the table has no `xfrc_applied`, and nothing is done.
    """
    bodies = bodies_of(table)
    for slot in range(len(bodies) if table[memory.XFRC] != 0 else 0):
        body = bodies[slot]
        row, untouched = row_of_body(table, body)
        if untouched:
            for k in range(6):
                row[k] = body.user_wrench[k]
                body.last_wrench[k] = body.user_wrench[k]
