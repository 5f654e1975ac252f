"""Draw `sand.png`, the seamless texture of the bed: grains in the colors of quartz sand.

Run it after changing it; needs numpy, scipy and pillow.
"""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

SIZE = 512  # pixels
GRAIN = 1.1  # blur that makes a grain of a few pixels
COLOURS = np.array([[158, 122, 80], [186, 150, 104], [205, 172, 124], [222, 196, 152]])


def main() -> None:
    """Draw the texture."""
    rng = np.random.default_rng(7)
    grains = gaussian_filter(rng.standard_normal((SIZE, SIZE)), GRAIN, mode="wrap")
    patches = gaussian_filter(rng.standard_normal((SIZE, SIZE)), 25, mode="wrap")
    tone = grains / grains.std() + 0.15 * patches / patches.std()
    # The same number of pixels of each tone, from dark to light.
    rank = tone.ravel().argsort().argsort().reshape(SIZE, SIZE) / SIZE**2
    position = rank * (len(COLOURS) - 1)
    low = position.astype(int).clip(0, len(COLOURS) - 2)
    part = (position - low)[..., None]
    picture = (1 - part) * COLOURS[low] + part * COLOURS[low + 1]
    image = Image.fromarray(picture.round().astype(np.uint8)).quantize(16, dither=Image.Dither.NONE)
    file = Path(__file__).parents[1] / "models" / "assets" / "sand.png"
    image.convert("RGB").save(file, optimize=True)


if __name__ == "__main__":
    main()
