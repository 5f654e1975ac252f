"""The explicit scheme: the law at the current state, once per step.

MuJoCo's Euler integrator is a leapfrog scheme: it computes `v' = v + h a(x, v)` and then
`x' = x + h v'`, so with positions at times `t` the velocities belong to `t - h/2`. For forces of
position alone that is second order. Drag depends on velocity, and at `v` it is half a step late; on
the paper's 10 m/s impact at 1e-4 s this alone costs 1 % of the depth. So velocities are advanced by
half a step, `v + (h/2) a` with `a` the acceleration of the last step (Adams-Bashforth of second
order for the velocity, leapfrog for the position). It costs one sum along the joint chain.
"""

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np

from mjgranular._util.checks import check_switch
from mjgranular.errors import InputError, shown
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.fields import rows
from mjgranular.kernel.memory import SCENE, WARMSTART, records, scratch, table_at
from mjgranular.kernel.motion import motion_along, read_motion, still, velocity_at, write_motion
from mjgranular.kernel.records import bodies_of
from mjgranular.kernel.vector import Vector, cross
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.forces import add_total, force_kernel
from mjgranular.scheme.layout import ARM, FORCE, LED, VELOCITY, WEIGHT, tile_size
from mjgranular.scheme.sampling import sampling_kernel
from mjgranular.scheme.scheme import FINE, Scheme, check_options
from mjgranular.scheme.wrenches import add_wrenches, find_bad_wrench, pose_at


@dataclass(frozen=True)
class Explicit(Scheme):
    """The law at the current state.

    Attributes:
        half_step: advance velocities by half a step from `qvel`, to the time of the positions.
            Without it the scheme is of first order in depth too.
        longest_step: the longest time step that may be set later [s]; longer steps raise an error,
            since they may add energy.
        prescribed: bodies follow a prescribed motion: the law at the velocity that they have. Then
            added mass, which depends on accelerations, is omitted.
    """

    name: ClassVar[str] = "explicit"

    half_step: bool = True
    longest_step: float = 1e9  # any
    prescribed: bool = False

    def __post_init__(self) -> None:
        check_switch("Explicit: half_step", self.half_step)
        if not (isinstance(self.longest_step, (int, float)) and self.longest_step > 0.0):
            raise InputError(
                f"Explicit: longest_step must be positive, not {shown(self.longest_step)} s"
            )

    @property
    def step_limit(self) -> float:
        return self.longest_step

    @property
    def lead(self) -> float:
        return 0.5 if self.half_step else 0.0

    def program(self, kernel: LawKernel, scene: np.dtype) -> Any:
        if kernel.added is not None and not self.prescribed:
            raise InputError(
                "sand that is moved along (the law's `added`) needs scheme='implicit': the "
                "explicit scheme knows no acceleration; or take a quasi-static law, such as "
                "law='rft3d'"
            )
        return explicit_program(replace(kernel, added=None), scene)


@cache
def explicit_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Compile law and scheme as one call that adds the law's wrenches to `xfrc_applied`."""
    lanes, size = kernel.lanes, tile_size(kernel)
    force_on, scene_records, room = force_kernel(kernel), records(scene_dtype), scratch(size)
    read_all, write_all = rows(Vector, lanes).read, rows(Vector, lanes).write
    read_weight = rows(float, lanes).read

    @partial(compiled, inline=True)
    def act(table, workspace, body, place, g, tile, number, live, is_first, lead):
        """Compute the forces on a tile, and add them to its body's wrench."""
        if is_first:  # most bodies of a robot are above the sand
            # The last acceleration is zero after a reset, and part of MuJoCo's integration state:
            # a copied simulation continues as the original does.
            change = motion_along(table, body.last_dof, table[WARMSTART], lead)
            write_motion(body.change, 0, change)
        # Drag takes the velocity ahead, static resistance the direction of the present velocity:
        # with the velocity ahead it creeps five times faster under load.
        arm = read_all(tile, ARM * lanes)
        led = velocity_at(read_motion(body.change, 0), arm)
        write_all(tile, LED * lanes, read_all(tile, VELOCITY * lanes) + led)
        force_on(tile, scene_records(table[SCENE], 1)[0].law, g, 0.0)
        pose = pose_at(place)
        force = read_weight(tile, WEIGHT * lanes) * read_all(tile, FORCE * lanes)
        add_total(body.wrench, 0, force)
        add_total(body.wrench, 3, cross(arm + (pose.tree - pose.com), force))

    sample_all = sampling_kernel(kernel, scene_dtype, act, compact=False)

    @compiled
    def program(address, lead):
        table = table_at(address)
        status = check_options(table)
        if status != FINE:
            return status
        bodies = bodies_of(table)
        for slot in range(len(bodies)):
            write_motion(bodies[slot].wrench, 0, still())
        tile = room()
        sample_all(table, 0, tile.ctypes.data, 0, lead)
        bad = find_bad_wrench(table)
        if bad < 0:
            add_wrenches(table)
        return bad

    return program
