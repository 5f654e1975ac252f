"""Values and settings as TOML, which the standard library reads and does not write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from mjgranular.learn.settings import Settings

_TABLES = ("arguments", "policy")


def toml_text(value: Any) -> str:
    """A value as TOML: what `settings.toml_value` reads is equal to it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_key(k)} = {toml_text(v)}' for k, v in value.items())}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_text, value))}]"
    return repr(value)


def settings_text(settings: Settings, comment: str) -> str:
    """A file that `settings.read_settings` reads as these settings.

    Args:
        settings: to write.
        comment: for the first line.
    """
    one_line = " ".join(comment.split())
    lines = [f"# {one_line}", "", f"algorithm = {toml_text(settings.algorithm)}"]
    own = [f.name for f in fields(Settings) if f.name not in ("algorithm", "environment", *_TABLES)]
    tables = {
        "environment": settings.environment,
        settings.algorithm: {name: getattr(settings, name) for name in own},
        **{f"{settings.algorithm}.{name}": getattr(settings, name) for name in _TABLES},
    }
    for title, table in tables.items():
        if table:
            lines += ["", f"[{title}]"]
            lines += [f"{_key(name)} = {toml_text(value)}" for name, value in table.items()]
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    bare = name.isascii() and name.replace("-", "_").isidentifier()
    return name if bare else toml_text(name)
