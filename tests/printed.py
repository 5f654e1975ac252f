"""What was printed beside what a page shows."""

import re

import pytest

NUMBER = re.compile(r"(?<![\w.])([-+]?\d+\.?\d*(?:e[-+]?\d+)?)(?![\w])")


def parts(text: str) -> list[str | float]:
    """Words and numbers."""
    words = (part for piece in NUMBER.split(text) for part in piece.split())
    return [float(part) if NUMBER.fullmatch(part) else part for part in words]


def check_printed(printed: str, shown: str) -> None:
    """Asserts that they are the same, numbers to three parts in a thousand."""
    expected = [
        pytest.approx(part, rel=3e-3, abs=1e-13) if isinstance(part, float) else part
        for part in parts(shown)
    ]
    assert parts(printed) == expected, printed
