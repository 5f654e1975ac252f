"""Errors: one root, and beneath it the built-in that a caller would expect.

Every message is one sentence that says what was wrong and what would have been right.
"""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Iterable, Sequence

# Texts of files, models and arguments stand in messages: what a message shows of them is bounded.
_LONGEST_VALUE = 80  # characters of one value; chosen, as the two below
_LONGEST_LIST = 1000  # of the names that there are
_LONGEST_MESSAGE = 2000
_SHORT_LIST = 12  # names that are listed even if one of them is near
_PART = 3  # characters of a name that are looked for in others


def shown(value: object) -> str:
    """Return a value as a message shows it: short, whatever it is."""
    if isinstance(value, str):
        return repr(_cut(value, _LONGEST_VALUE))
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a number of {value.bit_length()} bits"
    if isinstance(value, (list, tuple)):
        flat = len(value) <= 8 and not any(isinstance(one, (list, tuple, dict)) for one in value)
        return f"[{', '.join(map(shown, value))}]" if flat else f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    return _cut(repr(value), _LONGEST_VALUE)


def one_line(text: str) -> str:
    """Return a text without line breaks, and with characters that cannot be printed written as escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in text)


def listed(names: Iterable[str]) -> str:
    """Names with commas between them: as many as a message bears, and how many more there are."""
    known = list(names)
    length, count = 0, 0
    for name in known:
        length += len(name) + 2
        if length > _LONGEST_LIST:
            break
        count += 1
    text = ", ".join(known[:count]) or "none"
    return text if count == len(known) else f"{text}, and {len(known) - count} more"


def _known_ones(name: object, known: Sequence[str], *, guess: bool = True) -> str:
    """End of a sentence on an unknown name: those that may have been meant, and those there are."""
    near = _near(str(name)[:_LONGEST_VALUE].lower(), known) if guess else []
    if near and len(known) > _SHORT_LIST:
        return f"; did you mean {', '.join(near)}? There are {len(known)} in all"
    return f"; there are: {listed(known)}" + (f"; did you mean {near[0]}?" if near else "")


def _near(name: str, known: Sequence[str]) -> list[str]:
    """Up to three names that resemble one, or have it in them; capitals do not count."""
    # `Hexapod-v0` is meant by somebody who leaves the namespace away, as is a robot's `foot`.
    lower = {one.rpartition("/")[2].lower(): one for one in known}
    lower |= {one.lower(): one for one in known}
    close = difflib.get_close_matches(name, lower, n=6, cutoff=0.6)  # of one name there may be two
    within = [one for one in lower if len(name) >= _PART and name in one]
    return list(dict.fromkeys(lower[one] for one in (close or within)))[:3]


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 3] + "..."


class GranularError(Exception):
    """Root of all errors that mjgranular raises on purpose.

    Its message is one line of bounded length whatever names and values it tells of.
    """

    def __init__(self, *arguments: object) -> None:
        # Cleaned before it is cut: an escape is longer than what it stands for.
        clean = (
            _cut(one_line(a), _LONGEST_MESSAGE) if isinstance(a, str) else a for a in arguments
        )
        super().__init__(*clean)


class InputError(GranularError, ValueError):
    """A value given by the user is outside what the physics or the model allows."""


class UnknownNameError(GranularError, KeyError):
    """A name that does not exist, told together with those that do.

    Args:
        kind: what the name was meant to name ("medium", "law", "camera", ...).
        name: the name as given.
        known: the valid names.
        hint: what else would do, if anything.
        guess: whether the name may be a misspelt one of those.
    """

    def __init__(
        self,
        kind: str,
        name: object,
        known: Iterable[str],
        hint: str = "",
        guess: bool = True,
    ) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(known)
        self.hint = hint
        self.guess = guess
        rest = _known_ones(name, self.known, guess=guess)
        super().__init__(f"no {kind} {shown(name)}{rest}{hint and ' '}{hint and f'({hint})'}")

    def __str__(self) -> str:  # KeyError would show the message in quotes
        return str(self.args[0])

    def __reduce__(self) -> tuple[type, tuple[str, object, tuple[str, ...], str, bool]]:
        return type(self), (self.kind, self.name, self.known, self.hint, self.guess)


class UnknownArgumentError(GranularError, TypeError):
    """A keyword argument that a call does not take, told together with those that it does.

    Args:
        call: name of what was called.
        name: the argument as given.
        known: the arguments that there are.
    """

    def __init__(self, call: str, name: str, known: Iterable[str]) -> None:
        self.call, self.name, self.known = call, name, tuple(known)
        rest = _known_ones(name, self.known)
        super().__init__(f"{call} has no argument {shown(name)}{rest}")

    def __reduce__(self) -> tuple[type, tuple[str, str, tuple[str, ...]]]:
        return type(self), (self.call, self.name, self.known)


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


class FloorWarning(GranularWarning):
    """Ground of the model's own carries bodies at or above the sand's surface."""


class PointsWarning(GranularWarning):
    """Bodies meet the sand with geoms that are points beside what is drawn, and will sink."""


class CostWarning(GranularWarning):
    """So many elements that steps take long."""


class MissedStepWarning(GranularWarning):
    """Time has gone on without the sand, which was to act in every step."""


class RangeWarning(GranularWarning):
    """A value that no sand or simulation has: a slip of units, most likely."""


class UnfeltWarning(GranularWarning):
    """Something that moves without the sand's acting on it, or with motion that it is not told."""


def warn_user(message: str, kind: type[GranularWarning] = GranularWarning) -> None:
    """Warn with a `GranularWarning` that points at the user's line, the last outside this package.

    Args:
        message: one sentence, as an error's.
        kind: of warning.
    """
    package = __name__.partition(".")[0]
    frame, level = sys._getframe(1), 2
    while frame.f_back and str(frame.f_globals.get("__name__")).partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(_cut(one_line(message), _LONGEST_MESSAGE), kind, stacklevel=level)
