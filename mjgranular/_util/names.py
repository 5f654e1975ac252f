"""Names of what is in a model, whatever bytes the model's file has there."""

from __future__ import annotations

import mujoco


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of a body, geom or the like, "" for none; bytes that are no UTF-8 are shown.

    MuJoCo takes them, but its Python bindings raise `UnicodeDecodeError` where they are read.

    Args:
        model: the model.
        kind: `body`, `geom`, `flex`, `pair`.
        number: its id.
    """
    names, begin = model.names, int(getattr(model, f"name_{kind}adr")[number])
    return names[begin : names.index(b"\0", begin)].decode(errors="backslashreplace")
