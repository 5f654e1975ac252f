"""Imports that come with an extra of the package, with the install line where one is missing."""

from __future__ import annotations

import importlib
from typing import Any

from mjgranular.errors import MissingExtraError


def need(package: str, *, extra: str, purpose: str) -> Any:
    """Import a module.

    Args:
        package: its dotted name.
        extra: the extra of mjgranular that brings it.
        purpose: what it is wanted for, at the beginning of a sentence.

    Raises:
        MissingExtraError: it is not installed; gives the install line.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        missing = (error.name or package).partition(".")[0]
        raise MissingExtraError(missing, extra, purpose) from None
