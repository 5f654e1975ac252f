"""Comparison of a law with a measured run."""

from __future__ import annotations

from dataclasses import dataclass

from mjgranular import Law
from mjgranular.calibrate import Errors, Motion, Run, RunSet


@dataclass(frozen=True)
class Candidate:
    """A law for a set of runs.

    Attributes:
        name: name on the page.
        law: the law with its constants.
        fitted_to: names of the runs that a constant was fitted to; empty if nothing was fitted.
        constants: short description of their source.
    """

    name: str
    law: Law
    fitted_to: tuple[str, ...]
    constants: str


@dataclass(frozen=True)
class Comparison:
    """A run with a law; no errors if the law has no elements for the body."""

    runs: RunSet
    run: Run
    candidate: Candidate
    motion: Motion | None
    errors: Errors | None

    @property
    def mark(self) -> str:
        """Label of the run for this law: "fitted" only if this law was fitted to it."""
        if self.run.name in self.candidate.fitted_to:
            return "fitted to"
        return "seen" if self.run.mark == "fitted to" else self.run.mark
