"""Constraints that are as stiff in sand as without it.

MuJoCo's integrator `discrete` makes the regularization D of a constraint larger by what its metric
is larger than the inertia matrix. That metric has the sand's damping in it here, on the processor
it has not; limits of a robot that lies would be some thousand times as stiff.
"""

# Kernels take arrays in Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false, reportAssignmentType=false

from typing import Any

import mujoco_warp as mjw
import warp as wp


class Constraints:
    """Regularization and reference of constraints as they are without sand.

    `mujoco_warp.fwd_actuation` assembles the metric and scales D by it. This counts on two things
    of it alone: a D that goes in larger comes out larger by the same factor; and what it adds to a
    reference, for adhesion, goes with the change of 1 / D.
    """

    def __init__(self, d: Any) -> None:
        self._regularization = wp.zeros_like(d.efc.D)
        self._reference = wp.zeros_like(d.efc.aref)

    def find(self, m: Any, d: Any) -> None:
        """Lets MuJoCo Warp scale them by its metric, in which there is no sand yet."""
        mjw.fwd_actuation(m, d)
        wp.copy(self._regularization, d.efc.D)
        wp.copy(self._reference, d.efc.aref)

    def solve(self, m: Any, d: Any) -> None:
        """Solves MuJoCo Warp's equations with sand in the metric, but for this."""
        self._with_sand(m, d)
        self._restore(d)
        mjw.fwd_acceleration(m, d, factorize=True)
        mjw.solve(m, d)

    def prepare(self, m: Any, d: Any) -> None:
        """Makes them such that MuJoCo Warp's own scaling, by the metric of now, ends with them."""
        self._with_sand(m, d)
        wp.launch(
            _prepare,
            dim=d.efc.D.shape,
            inputs=[d.nefc, self._regularization, self._reference],
            outputs=[d.efc.D, d.efc.aref],
            device=d.efc.D.device,
        )

    def _with_sand(self, m: Any, d: Any) -> None:
        self._restore(d)
        mjw.fwd_actuation(m, d)

    def _restore(self, d: Any) -> None:
        wp.copy(d.efc.D, self._regularization)
        wp.copy(d.efc.aref, self._reference)


@wp.kernel(enable_backward=False)
def _prepare(
    nefc: wp.array(dtype=int),
    regularization: wp.array2d(dtype=float),
    reference: wp.array2d(dtype=float),
    scaled: wp.array2d(dtype=float),
    moved: wp.array2d(dtype=float),
):
    """Undoes in advance what was done to D and to the reference, which are found scaled.

    With s = D / D_scaled, what is added to the reference of D s is 1 / s of what was added to that
    of D, because it goes with 1 / D_out - 1 / D_in.
    """
    world, row = wp.tid()
    if row >= nefc[world]:
        return
    right, found = regularization[world, row], scaled[world, row]
    if not (right > 0.0 and found > 0.0):
        return
    shift = moved[world, row] - reference[world, row]
    scaled[world, row] = right * (right / found)
    moved[world, row] = reference[world, row] - shift * (found / right)
