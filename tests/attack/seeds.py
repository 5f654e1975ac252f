"""Seed and number of cases of an attack: `ATTACK_SEED=7 ATTACK_CASES=1000 pytest tests/attack`."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import hypothesis

SEED = int(os.environ.get("ATTACK_SEED", "1"))


def cases(default: int) -> int:
    """Return the number of cases."""
    return int(os.environ.get("ATTACK_CASES", default))


def attacked(default: int) -> Callable[[Any], Any]:
    """Decorate a test of hypothesis with the seed and the number of cases."""
    settings = hypothesis.settings(
        max_examples=cases(default), suppress_health_check=list(hypothesis.HealthCheck)
    )
    return lambda test: hypothesis.seed(SEED)(settings(test))
