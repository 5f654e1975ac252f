"""Layout of a tile: up to `lanes` elements of one body side by side.

A tile consists of rows with one number per lane. Loops over lanes have a fixed length and contain
only arithmetic, so that the compiler vectorizes them; unused lanes repeat the last element with
zero weight. A law with one lane has tiles of one element.
"""

import numpy as np

from mjgranular.kernel.fields import size_of
from mjgranular.law.kernel import LawKernel

# First rows: from the center of the tree to the point of action [m]; last evaluated velocity [m/s]
# and its multiplier; the `Response` to these (force first); 1, or 0 for an unused lane; index of
# the element, an integer's bits; velocity for drag, of the explicit scheme; the sample.
ARM, VELOCITY, MULTIPLIER, FORCE, WEIGHT, INDEX, LED, SAMPLE = 0, 3, 6, 9, 22, 23, 24, 27
SLOPE, MISMATCH = FORCE + 3, FORCE + 12
TURN = MISMATCH  # reuses the row, which is not needed any more
POINT = SAMPLE + 2
ADDED_ROWS = 6  # of `scheme.added.Momentum`, and the distance of a below its bound [N]
SLACK = 5

HEAD_DTYPE = np.dtype([("body", np.int64), ("live", np.int64)])


def added_row(kernel: LawKernel) -> int:
    """Return the first row of added mass (`scheme.added`)."""
    return SAMPLE + size_of(kernel.samples)


def element_row(kernel: LawKernel) -> int:
    """Return the first row of the elements themselves, where they are packed side by side.

    They come last: a program of forces, which does not read them, is the same for all surfaces.
    """
    return added_row(kernel) + (0 if kernel.added is None else ADDED_ROWS)


def tile_size(kernel: LawKernel) -> int:
    """Return the number of numbers in a tile."""
    gathered = size_of(kernel.element) if kernel.side_by_side else 0
    return (element_row(kernel) + gathered) * kernel.lanes
