"""Finds, on import, the folders `models` and `envs` of a checkout.

`python -m` and `python -c` put the current folder first on the path. In a checkout that hides the
installed package behind this folder, which lacks what setup.py maps into it: it lies beside.
"""

from __future__ import annotations

from pathlib import Path

import mjgranular

_here = Path(__file__).resolve().parent
if not (_here / "models").is_dir() and (_here.parent / "setup.py").is_file():
    mjgranular.__path__.append(str(_here.parent))
