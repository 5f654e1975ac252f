"""A case of an attack and its result.

An attack is a module with `draw(seed, number, options)`, which returns a case or None where there
is nothing to check, and `run(case)`, which returns a `Result`. A case has a method `describe`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import mjgranular


@dataclass
class Result:
    """Result of a case.

    Attributes:
        counts: how often each check was made, by its name.
        failures: the first failure of each check, in words.
    """

    counts: Counter[str] = field(default_factory=Counter)
    failures: dict[str, str] = field(default_factory=dict)

    def fail(self, check: str, text: str) -> None:
        """Record a failure, unless one of the same check is known."""
        self.failures.setdefault(check, text)


@dataclass
class ModelCase:
    """A model, its sand and what happens to it.

    Attributes:
        xml: the model without sand, in MJCF.
        sand: arguments of `Sand`, as they would be written.
        program: law, surface and scheme.
        number: number of the case, the seed of further draws.
        kind: kind of events.
        events: lines of Python by the step before which they run, as pairs.
        steps: number of steps.
        settled: step from which everything must be at rest; None for no such step.
    """

    xml: str
    sand: str
    program: tuple[str, str, str]
    number: int
    kind: str = "plain"
    events: list[tuple[int, str]] = field(default_factory=list)
    steps: int = 0
    settled: int | None = None

    def describe(self) -> str:
        """Return the case in lines that can be pasted into a script."""
        events = "\n".join(f"{step:4d}  {line}" for step, line in self.events)
        return f"{self.xml}\n\n{self.kind}: Sand(model, {self.sand})\n{events}"


def arguments(sand: str) -> dict[str, Any]:
    """Parse the arguments of `Sand` from a string."""
    return eval(f"dict({sand})", vars(mjgranular).copy())
