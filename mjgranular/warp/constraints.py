"""Keep constraints as stiff in sand as without it.

MuJoCo's integrator `discrete` scales the regularization D of a constraint by the ratio of its
metric to the inertia matrix. In MuJoCo Warp that metric contains the sand's damping, on the CPU it
does not: uncorrected, joint limits of a robot in sand would be about a thousand times too stiff.
"""

# Kernels annotate arrays in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false, reportAssignmentType=false

from typing import Any

import mujoco_warp as mjw
import warp as wp


class Constraints:
    """Regularization and reference of constraints as they are without sand.

    `mujoco_warp.fwd_actuation` assembles the metric and scales D by it. This class relies on two of
    its properties only: a larger D in gives a D out that is larger by the same factor; and what it
    adds to a reference, for adhesion, is proportional to the change of 1 / D.
    """

    def __init__(self, d: Any) -> None:
        self._regularization = wp.zeros_like(d.efc.D)
        self._reference = wp.zeros_like(d.efc.aref)

    def find(self, m: Any, d: Any) -> None:
        """Have MuJoCo Warp scale them by its metric while it contains no sand."""
        mjw.fwd_actuation(m, d)
        wp.copy(self._regularization, d.efc.D)
        wp.copy(self._reference, d.efc.aref)

    def solve(self, m: Any, d: Any) -> None:
        """Solve MuJoCo Warp's equations with sand in the metric, except for constraints."""
        self._restore(d)
        mjw.fwd_actuation(m, d)
        self._restore(d)
        mjw.fwd_acceleration(m, d, factorize=True)
        mjw.solve(m, d)

    def prepare(self, m: Any, d: Any) -> None:
        """Set inputs for which MuJoCo Warp's own scaling, by the current metric, returns them."""
        self._restore(d)
        mjw.fwd_actuation(m, d)
        wp.launch(
            _prepare,
            dim=d.efc.D.shape,
            inputs=[d.nefc, self._regularization, self._reference],
            outputs=[d.efc.D, d.efc.aref],
            device=d.efc.D.device,
        )

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
    """Invert the scaling of D and of the reference in advance; both are found scaled.

    With s = D / D_scaled, what is added to the reference of D s is 1 / s of what was added to that
    of D, because it is proportional to 1 / D_out - 1 / D_in.
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
