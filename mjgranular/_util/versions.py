"""Versions that a result depends on."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mjgranular._version import __version__

_PACKAGES = ("mujoco", "numpy", "numba")


def versions(*further: str) -> dict[str, Any]:
    """Return versions of Python, of packages that affect results and of `further`; the platform."""
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "mjgranular": __version__,  # that of an editable installation may be old
    }
    for package in (*_PACKAGES, *further):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def mismatch(here: Mapping[str, Any], there: Mapping[str, Any]) -> str | None:
    """Return packages whose versions differ in two processes, with both; None if none do."""
    different = [
        f"{name} {there.get(name) or 'none'} there and {here.get(name) or 'none'} here"
        for name in ("mjgranular", *_PACKAGES)
        if here.get(name) != there.get(name)
    ]
    return ", ".join(different) or None
