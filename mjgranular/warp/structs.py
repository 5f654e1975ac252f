"""Make Warp structs from their fields."""

from __future__ import annotations

from typing import Any

import warp as wp


def struct(name: str, fields: dict[str, Any]) -> Any:
    """Make a Warp struct."""
    return wp.struct(type(name, (), {"__annotations__": fields, "__module__": __name__}))
