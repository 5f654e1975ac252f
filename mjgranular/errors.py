"""Errors: a common base class, combined with the built-in class that a caller would expect.

Every message is one sentence that says what is wrong and what would be right.
"""

from __future__ import annotations

import difflib
import os
import re
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Messages contain strings from files, models and arguments: their length is limited.
_LONGEST_VALUE = 80  # characters of one value; chosen, as those below
_LONGEST_MESSAGE = 2000
_SHORT_LIST = 12  # names that are listed even if one of them is similar
_PART = 3  # characters of a name that are searched in others


def shown(value: object) -> str:
    """Format any value for a message, in limited length."""
    if isinstance(value, str):
        return repr(cut(value, _LONGEST_VALUE))
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a number of {value.bit_length()} bits"
    if isinstance(value, (list, tuple)):
        flat = len(value) <= 8 and not any(isinstance(one, (list, tuple, dict)) for one in value)
        return f"[{', '.join(map(shown, value))}]" if flat else f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    return cut(repr(value), _LONGEST_VALUE)


def one_line(text: str) -> str:
    """Return a string without line breaks, with unprintable characters escaped."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in text)


def listed(names: Iterable[str]) -> str:
    """Join names with commas; a message that becomes too long is cut."""
    return ", ".join(names) or "none"


def _known_ones(name: object, known: Sequence[str]) -> str:
    """Return the end of a message on an unknown name: similar names, and the valid ones."""
    near = similar_names(name, known)
    if near and len(known) > _SHORT_LIST:
        return f"; did you mean {', '.join(near)}? There are {len(known)} in all"
    return f"; there are: {listed(known)}" + (f"; did you mean {near[0]}?" if near else "")


def similar_names(given: object, known: Sequence[str]) -> list[str]:
    """Return up to three names that resemble or contain a name, ignoring case."""
    name = str(given)[:_LONGEST_VALUE].lower()
    # `Hexapod-v0` may be given without its namespace, as may a robot's `foot`.
    lower = {one.rpartition("/")[2].lower(): one for one in known}
    lower |= {one.lower(): one for one in known}
    close = difflib.get_close_matches(name, lower, n=6, cutoff=0.6)  # one name may occur twice
    # A common namespace does not make names alike.
    own = name.rpartition("/")[2]
    close = [one for one in close if difflib.get_close_matches(own, [one.rpartition("/")[2]])]
    within = [one for one in lower if len(name) >= _PART and name in one]
    return list(dict.fromkeys(lower[one] for one in (close or within)))[:3]


def cut(text: str, longest: int) -> str:
    """Return a string, shortened to a length."""
    return text if len(text) <= longest else text[: longest - 3] + "..."


class GranularError(Exception):
    """Base class of all errors that mjgranular raises on purpose.

    Its message is one line of bounded length for any names and values in it.
    """

    def __init__(self, *arguments: object) -> None:
        # Escape before truncating: an escape is longer than the character.
        clean = (cut(one_line(a), _LONGEST_MESSAGE) if isinstance(a, str) else a for a in arguments)
        super().__init__(*clean)

    def __reduce__(self) -> tuple[Any, ...]:
        # Not by `__init__`, whose arguments are others than the message.
        return type(self).__new__, (type(self),), {**vars(self), "args": self.args}


class InputError(GranularError, ValueError):
    """A value given by the user is outside what the physics or the model allows."""


class UnknownNameError(GranularError, KeyError):
    """A name that does not exist; the message lists those that do, `known`, and adds a hint.

    `kind` says what is named: "medium", "law", "camera", ...
    """

    def __init__(
        self, kind: str, name: object = None, known: Iterable[str] | None = None, hint: str = ""
    ) -> None:
        self.kind, self.name, self.known, self.hint = kind, name, tuple(known or ()), hint
        if known is not None:  # Gymnasium and others raise an error again, from its message alone
            rest = _known_ones(name, self.known)
            kind = f"no {kind} {shown(name)}{rest}{hint and ' '}{hint and f'({hint})'}"
        super().__init__(kind)

    def __str__(self) -> str:  # KeyError would show the message in quotes
        return str(self.args[0])


class UnknownArgumentError(GranularError, TypeError):
    """An unknown keyword argument of a `call`; the message lists the valid ones."""

    def __init__(self, call: str, name: str | None = None, known: Iterable[str] = ()) -> None:
        if name is not None:  # otherwise `call` is the message
            call += f" has no argument {shown(name)}{_known_ones(name, tuple(known))}"
        super().__init__(call)


class UnstableError(GranularError, ArithmeticError):
    """The simulation diverged: forces or speeds that no passive medium can cause."""


class OutputError(GranularError, OSError):
    """A folder or file cannot be written, or has content that must not be lost."""


class RenderError(GranularError, RuntimeError):
    """Rendering does not work on this machine."""


@contextmanager
def drawing(what: str = "MuJoCo cannot draw on this machine") -> Iterator[None]:
    """Raise a `RenderError` for any error of the block: OpenGL fails differently everywhere."""
    try:
        yield
    except GranularError:
        raise
    except Exception as error:
        raise RenderError(
            f"{what} ({type(error).__name__}: {error}); on Linux "
            "without a screen install libegl1 (apt-get install libegl1 libgl1-mesa-dri), import "
            "mjgranular before mujoco or set MUJOCO_GL=egl "
            f"(it is {os.environ.get('MUJOCO_GL')!r}), and use render_mode='rgb_array'"
        ) from None


@contextmanager
def loading(title: object) -> Iterator[None]:
    """Turn errors of MuJoCo into an `InputError` that names the model."""
    import mujoco  # after `_util.display` has chosen a renderer

    try:
        yield
    except GranularError:
        raise
    except (ValueError, OSError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        ours = re.search("engine error: mjgranular '[^']*': (.*)", reason)
        raise InputError(ours[1] if ours else f"MuJoCo cannot load {title}: {reason}") from None


class MissingExtraError(GranularError, ImportError):
    """A package that an extra of mjgranular installs is not there; `purpose` needed it."""

    def __init__(self, package: str, extra: str = "", purpose: str = "") -> None:
        install = f"which is not installed: pip install 'mjgranular[{extra}]'"
        super().__init__(f"{purpose} needs {package}, {install}" if extra else package)


class GranularWarning(UserWarning):
    """Something that can be computed, but may not be intended."""


class FloorWarning(GranularWarning):
    """The model's own ground supports bodies at or above the sand's surface."""


class PointsWarning(GranularWarning):
    """Bodies meet the sand only with geoms tiny compared to what is drawn, and will sink."""


class CostWarning(GranularWarning):
    """The number of elements makes steps slow."""


class MissedStepWarning(GranularWarning):
    """The time has advanced without the sand, which should act in every step."""


class RangeWarning(GranularWarning):
    """A value that is implausible for sand: most likely a wrong unit."""


class UnfeltWarning(GranularWarning):
    """Something moves without force from the sand, or with motion that the sand ignores."""


def warn_user(message: str, kind: type[GranularWarning] = GranularWarning) -> None:
    """Warn with a `GranularWarning` that points at the user's line, the last outside this package.

    The message is one sentence, as for an error.
    """
    frame = _outside(sys._getframe(1))
    if _is_ours(frame):  # compiled in another thread, for which the main one waits
        frame = _outside(sys._current_frames()[threading.main_thread().ident or 0])
    text, file = cut(one_line(message), _LONGEST_MESSAGE), frame.f_code.co_filename
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    warnings.warn_explicit(
        text, kind, file, frame.f_lineno, frame.f_globals.get("__name__"), registry
    )


def _outside(frame: FrameType) -> FrameType:
    """Return the last frame outside this package; the first of the thread if all are inside."""
    while frame.f_back and _is_ours(frame):
        frame = frame.f_back
    return frame


def _is_ours(frame: FrameType) -> bool:
    # Or a library's between a call of the user and ours: gymnasium.make, a cached property.
    ours = (__name__.partition(".")[0], "contextlib", "functools", "gymnasium")
    return str(frame.f_globals.get("__name__")).partition(".")[0] in ours
