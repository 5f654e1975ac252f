"""Films and pictures of prints: a trail of the hexapod, a crater of the link, a trench.

python docs/figures/prints_films.py [trail crater trench ...]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import mjgranular.envs  # isort: skip (before mujoco: it chooses how to draw)
import gymnasium
import imageio_ffmpeg
import mediapy
import mujoco
import numpy as np
from PIL import Image

from mjgranular.envs.gaits import Tripod
from mjgranular.learn.policies import load_policy

FOLDER = Path(__file__).resolve().parent
WIDTH, HEIGHT = 640, 400  # [px]
RATE = 25.0  # pictures a second
