"""What an attack has found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Finding:
    """Something that should not be.

    Attributes:
        kind: a word or two, the same for all of one kind.
        failed: whether it is against what is promised, or only worth knowing.
    """

    seed: int
    number: int
    step: int
    door: str
    kind: str
    text: str
    value: float = 0.0
    failed: bool = True
    about: dict[str, Any] = field(default_factory=dict)


def as_dict(finding: Finding) -> dict[str, Any]:
    """For JSON."""
    return asdict(finding)


def failure(
    seed: int,
    number: int,
    text: str,
    *,
    step: int = -1,
    door: str = "",
    kind: str = "the attack itself",
    failed: bool = True,
    about: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """A finding that is not of a step."""
    return as_dict(Finding(seed, number, step, door, kind, text, failed=failed, about=about or {}))
