"""Imports of optional dependencies; errors have the install line."""

import importlib
from typing import Any

from mjgranular.errors import MissingExtraError


def require(package: str, *, extra: str, purpose: str) -> Any:
    """Import a module of an optional dependency."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        missing = (error.name or package).partition(".")[0]
        raise MissingExtraError(missing, extra, purpose) from None
