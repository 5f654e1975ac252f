"""Names of a model's objects, for any bytes in the model's file."""

import mujoco


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of a body, geom or the like, "" for none; escape bytes that are not UTF-8.

    MuJoCo accepts such bytes, but its Python bindings raise `UnicodeDecodeError` on reading them.
    """
    names, begin = model.names, int(getattr(model, f"name_{kind}adr")[number])
    return names[begin : names.index(b"\0", begin)].decode(errors="backslashreplace")
