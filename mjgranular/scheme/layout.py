"""Layout of a tile: up to `lanes` elements of one body side by side.

A tile is rows of numbers, one number for each lane. Loops over lanes are of a fixed length and of
arithmetic alone, and the compiler makes vector instructions of them; lanes that are left over hold
the last element once more, with no weight. A law with one lane has tiles of one element.
"""

from __future__ import annotations

import numpy as np

from mjgranular.kernel.fields import size_of
from mjgranular.law.kernel import LawKernel

# First rows: from the centre of the tree to where force acts [m]; velocity last looked at [m/s] and
# the multiplier there; the `Response` to these (force first); 1, or nothing for a lane left over;
# number of the element, an integer's bits; velocity for drag, of the explicit scheme; the sample.
ARM, VELOCITY, MULTIPLIER, FORCE, WEIGHT, INDEX, LED, SAMPLE = 0, 3, 6, 9, 22, 23, 24, 27
SLOPE, MISMATCH = FORCE + 3, FORCE + 12
TURN = MISMATCH  # which is not needed any more
POINT = SAMPLE + 2
ADDED_ROWS = 6  # of `scheme.added.Momentum`, and by how much a is below its bound [N]
SLACK = 5

HEAD_DTYPE = np.dtype([("body", np.int64), ("live", np.int64)])


def element_row(kernel: LawKernel) -> int:
    """First row of the elements themselves, where they are put together side by side."""
    return SAMPLE + size_of(kernel.samples)


def added_row(kernel: LawKernel) -> int:
    """First row of what is known of sand that is moved along (`scheme.added`)."""
    return element_row(kernel) + (size_of(kernel.element) if kernel.side_by_side else 0)


def tile_size(kernel: LawKernel) -> int:
    """Number of numbers of a tile."""
    added = 0 if kernel.added is None else ADDED_ROWS
    return (added_row(kernel) + added) * kernel.lanes


def tile_count(kernel: LawKernel, elements: np.ndarray) -> int:
    """The most tiles that elements (field `slot`) may fill."""
    return sum(-(-int(n) // kernel.lanes) for n in np.bincount(elements["slot"]))
