"""Versions that a result depends on."""

from __future__ import annotations

import platform
from collections.abc import Mapping
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


def mismatch(here: Mapping[str, Any], there: Mapping[str, Any]) -> str | None:
    """Names packages of which two processes have different versions, with both; None if none."""
    different = [
        f"{name} {there.get(name) or 'none'} there and {here.get(name) or 'none'} here"
        for name in _PACKAGES
        if here.get(name) != there.get(name)
    ]
    return ", ".join(different) or None
