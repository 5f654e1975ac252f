"""Draws `impact_frames.jpg`: three instants of the first drop of the paper."""

from pathlib import Path

import numpy as np
from PIL import Image

from mjgranular.experiment import Impact, run_impact
from mjgranular.picture.video import Film, frames_of_impact


def main() -> None:
    """Draws the picture."""
    result = run_impact(Impact())
    assert result.stop is not None
    film = Film(camera="side", width=560, height=420, fps=5, seconds=1.0, hold=0.0)
    _, frames = frames_of_impact(film, result.impact, result.trajectory, result.stop.time)
    pictures = list(frames)
    row = np.hstack([pictures[i] for i in (0, 1, 4)])
    Image.fromarray(row).save(Path(__file__).with_name("impact_frames.jpg"), quality=88)


if __name__ == "__main__":
    main()
