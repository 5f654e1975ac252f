"""When points have stayed in one place for long enough to count as at rest."""

from __future__ import annotations

import numpy as np

# Rest: every point stays within this distance for this long, 1 mm/s. Chosen, not measured; the
# explicit scheme creeps and trembles at a speed that grows with the time step.
REST_WINDOW = 0.02
REST_DISTANCE = 2e-5

STILL = 1e-9
"""Speed of a point that stands [m/s]. The implicit scheme leaves some 1e-12 of either sign; chosen.
"""


class RestWatch:
    """Watches points.

    Attributes:
        since: time from which they have stayed where they are [s].
    """

    def __init__(self) -> None:
        self.since = 0.0
        self._low = np.zeros(0)
        self._high = np.zeros(0)

    def still(self, time: float, points: np.ndarray) -> bool:
        """Return whether the points have stayed where they are for the window of rest.

        Args:
            time: now [s].
            points: coordinates [m], any shape, always the same.
        """
        if self._low.size:
            low, high = np.minimum(self._low, points), np.maximum(self._high, points)
            if (high - low).max() <= REST_DISTANCE:
                self._low, self._high = low, high
                return time - self.since >= REST_WINDOW
        self._low = self._high = np.array(points)
        self.since = time
        return False
