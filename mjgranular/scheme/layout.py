"""What lies where in a block of elements (`scheme.blocks`)."""

from __future__ import annotations

import numpy as np

from mjgranular.kernel.memory import records
from mjgranular.law.kernel import LawKernel

# Rows of a block: from the centre of the tree to where force acts [m]; velocity last looked at
# [m/s] and the grip there; what `respond` gave for these (force, minus its derivative, bend:
# `law.kernel`); 1, or nothing for a lane left over; number of the element, an
# integer's bits; wrench about the centre
# of the tree, moment first, and minus its derivative by the body's motion, row by row; and what
# `immerse` gave.
ARM, VELOCITY, GRIP, FORCE, SLOPE, BEND, WEIGHT, INDEX = 0, 3, 6, 9, 12, 21, 22, 23
WRENCH, STIFFNESS, IMMERSED = 24, 30, 66
STRAY = STIFFNESS  # which is summed by the time that is needed

HEAD_DTYPE = np.dtype([("body", np.int64), ("live", np.int64)])
head_records = records(HEAD_DTYPE)


def block_size(kernel: LawKernel) -> int:
    """How many numbers a block has."""
    return (IMMERSED + 5 + kernel.numbers) * kernel.lanes


def block_count(kernel: LawKernel, elements: np.ndarray) -> int:
    """The most blocks that elements (field `slot`) may fill."""
    return sum(-(-int(n) // kernel.lanes) for n in np.bincount(elements["slot"]))
