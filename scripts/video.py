"""Film an impact: run it, and render it in slow motion with the force as an arrow.

python scripts/video.py film.mp4
"""

import math
import sys
from pathlib import Path

from mjgranular.experiment import Impact, run_impact
from mjgranular.picture.video import Film, frames_of_run, write_video


def main(path: Path, seconds: float) -> None:
    """Write a film of `seconds` seconds of a drop at 5 m/s, 30 degrees."""
    result = run_impact(Impact(speed=5.0, angle=math.radians(30)))
    if result.stop is None:
        raise SystemExit("T did not stop: nothing to film")
    film = Film(camera="side", seconds=seconds)
    link = result.impact.link
    count, pictures = frames_of_run(film, link, result.trajectory, stop=result.stop.time)
    write_video(path, film, count, pictures)
    print(f"{path}: {result.stop.time * 1e3:.1f} ms in {seconds:g} s")


if __name__ == "__main__":
    main(
        Path(sys.argv[1] if len(sys.argv) > 1 else "film.mp4"),
        float(sys.argv[2]) if len(sys.argv) > 2 else 5.0,
    )
