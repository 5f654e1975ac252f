"""Errors: one root, and beneath it the built-in that a caller would expect.

Every message is one sentence that says what was wrong and what would have been right.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable


class GranularError(Exception):
    """Root of all errors that mjgranular raises on purpose."""


class InputError(GranularError, ValueError):
    """A value given by the user is outside what the physics or the model allows."""


class UnknownNameError(GranularError, KeyError):
    """A name that does not exist, told together with those that do.

    Args:
        kind: what the name was meant to name ("medium", "law", "camera", ...).
        name: the name as given.
        known: the valid names.
    """

    def __init__(self, kind: str, name: object, known: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(known)
        listed = ", ".join(self.known) if self.known else "none"
        super().__init__(f"no {kind} {name!r}; there are: {listed}")

    def __str__(self) -> str:  # KeyError would show the message in quotes
        return str(self.args[0])

    def __reduce__(self) -> tuple[type, tuple[str, object, tuple[str, ...]]]:
        return type(self), (self.kind, self.name, self.known)


class UnstableError(GranularError, ArithmeticError):
    """The simulation left reason: forces or speeds that no passive medium can cause."""


class OutputError(GranularError, OSError):
    """A folder or file cannot be written, or holds something that must not be lost."""


class RenderError(GranularError, RuntimeError):
    """Nothing can be drawn on this machine as it is set up."""


class MissingExtraError(GranularError, ImportError):
    """An optional dependency is not installed.

    Args:
        package: the package that could not be imported.
        extra: the extra of mjgranular that brings it.
        purpose: what it was wanted for.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package = package
        self.extra = extra
        self.purpose = purpose
        super().__init__(
            f"{purpose} needs {package}, which is not installed: pip install 'mjgranular[{extra}]'"
        )

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.package, self.extra, self.purpose)


class GranularWarning(UserWarning):
    """Something that may not be what the user wants, but can be computed."""


def warn_user(message: str) -> None:
    """Warns with a `GranularWarning` that points at the user's line, the last outside this package.

    Args:
        message: one sentence, as an error's.
    """
    package = __name__.partition(".")[0]
    frame, level = sys._getframe(1), 2
    while frame.f_back and str(frame.f_globals.get("__name__")).partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, GranularWarning, stacklevel=level)
