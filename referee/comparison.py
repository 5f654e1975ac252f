"""A law held against a measured run."""

from __future__ import annotations

from dataclasses import dataclass

from mjgranular import Law
from mjgranular.referee import Errors, MeasuredRun, Motion, RunSet


@dataclass(frozen=True)
class Candidate:
    """A law for a set of runs.

    Attributes:
        name: on the page.
        law: with its constants.
        fitted_to: names of the runs that a constant was chosen by; empty for nothing fitted.
        constants: where they are from, in a few words.
    """

    name: str
    law: Law
    fitted_to: tuple[str, ...]
    constants: str


@dataclass(frozen=True)
class Comparison:
    """A run under a law; no errors where the law has no elements for the body."""

    runs: RunSet
    run: MeasuredRun
    candidate: Candidate
    motion: Motion | None
    errors: Errors | None

    @property
    def mark(self) -> str:
        """Of the run for this law: only what the law's own constants were chosen by is fitted."""
        if self.run.name in self.candidate.fitted_to:
            return "fitted to"
        return "seen" if self.run.mark == "fitted to" else self.run.mark
