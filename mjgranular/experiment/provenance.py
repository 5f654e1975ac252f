"""Provenance of a result: versions and machine."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

_PACKAGES = ("mjgranular", "mujoco", "numpy", "numba")


def versions(*further: str) -> dict[str, Any]:
    """Versions of Python, of the packages that results depend on and of `further`; the platform."""
    found: dict[str, Any] = {"python": platform.python_version(), "platform": platform.platform()}
    for package in (*_PACKAGES, *further):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found
