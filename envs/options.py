"""Options of tasks and gaits: each has the type of its default."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

from mjgranular._util.checks import check_switch
from mjgranular.errors import InputError, shown


def check_number(name: str, value: Any) -> None:
    """Check that a value is a finite number."""
    if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value):
        raise InputError(f"{name} must be a finite number, not {shown(value)}")


def check_option(name: str, value: Any, default: Any) -> None:
    """Check that a value has the type of the default: a boolean, a number, a range."""
    if isinstance(default, bool):
        check_switch(name, value)
    elif isinstance(default, (int, float)):
        check_number(name, value)
        if name.endswith("_scale") and value < 0:
            raise InputError(f"{name} must not be negative, not {shown(value)}")
    elif _is_range(default):
        if not _is_range(value):
            raise InputError(f"{name} must be a range, (low, high), not {shown(value)}")
        if value[0] > value[1]:
            raise InputError(f"{name} must be a range with its low end first, not {shown(value)}")


def _is_range(value: Any) -> bool:
    """Return True if a value is two numbers, which may be infinite."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        return False
    return all(isinstance(one, Real) and not math.isnan(one) for one in value)
