"""The folders `models` and `envs` of a checkout, which are next to the package."""

from collections.abc import MutableSequence
from pathlib import Path


def add_checkout_folders(path: MutableSequence[str]) -> None:
    """Add the root of a checkout to the path of the package, if `models` is missing from it.

    `python -m` and `python -c` put the current folder first on the path. In a checkout this folder
    then hides the installed package, but lacks what setup.py maps into it.
    """
    package = Path(__file__).resolve().parents[1]
    if not (package / "models").is_dir() and (package.parent / "setup.py").is_file():
        path.append(str(package.parent))
