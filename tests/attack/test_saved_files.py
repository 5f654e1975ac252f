"""Damaged and malicious results, runs and policies: read as data, or one clear error."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import pytest
from seeds import SEED, cases

FIRST = int(os.environ.get("ATTACK_CASE", "0"))


@pytest.mark.slow
def test_damaged_files_are_read_as_data_or_rejected(child_with: Callable[..., Any]) -> None:
    pytest.importorskip("stable_baselines3")
    import damaged_runs

    child = child_with(damaged_runs.prepare)
    numbers = range(FIRST, FIRST + cases(100))
    wrong = [child(damaged_runs.read_damaged, SEED, number) for number in numbers]
    assert not [text for text in wrong if text]
