"""MuJoCo's structs as records, from MuJoCo's own description (`mujoco.introspect`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from mujoco.introspect.structs import STRUCTS

_KINDS = {"mjtNum": np.float64, "int": np.int32}


def record_of(struct: str) -> np.dtype:
    """Return the record of a struct of numbers, with the layout of C.

    Args:
        struct: its name; all of its fields are `mjtNum`, `int` or arrays of these.
    """
    fields = []
    described: Any = STRUCTS[struct].fields
    for field in described:
        kind, _, size = str(field.type).partition(" [")
        shape = tuple(int(n) for n in size.rstrip("]").split("][")) if size else ()
        fields.append((field.name, _KINDS[kind], shape))
    return np.dtype(fields, align=True)
