"""Imports of optional dependencies; errors have the install line."""

from __future__ import annotations

import importlib
from typing import Any

from mjgranular.errors import MissingExtraError


def require(package: str, *, extra: str, purpose: str) -> Any:
    """Import a module of an optional dependency.

    Args:
        package: dotted name of the module.
        extra: the extra of mjgranular that installs it.
        purpose: what it is needed for, as the beginning of a sentence.

    Raises:
        MissingExtraError: it is not installed; gives the install line.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        missing = (error.name or package).partition(".")[0]
        raise MissingExtraError(missing, extra, purpose) from None
