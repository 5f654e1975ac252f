"""YAML restricted to mappings, lists and strings.

Only the parser of PyYAML runs, with its safe loader's grammar, and none of its constructors: no
object, date or number is made from a file, and the work is proportional to its size.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mjgranular._util.extras import require
from mjgranular._util.io import place, read_file
from mjgranular.errors import InputError, shown

# Chosen: a medium needs a depth of 4, and its longest string is a citation.
_DEEPEST = 8
_LONGEST_TEXT = 2000

_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}


class OutlineError(InputError):
    """Error in a YAML document, with its line."""


def read_outline_file(path: Path, what: str, *, largest: int, extra: str) -> Any:
    """Read a YAML file as `read_outline` does, of at most `largest` bytes.

    `what` is the expected content, for messages; `extra` installs PyYAML.
    """
    yaml = require("yaml", extra=extra, purpose=f"Reading {what} from a file")
    content = read_file(path, what, largest=largest)
    try:
        return read_outline(content.decode("utf-8"), yaml)
    except UnicodeDecodeError as error:
        raise InputError(f"{place(path)} is not YAML: byte {error.start} is not UTF-8") from None
    except OutlineError as error:
        raise InputError(f"{place(path)} is not YAML that can be read: {error}") from None


def read_outline(text: str, yaml: Any) -> Any:
    """Read YAML: dicts, lists, strings, and unquoted None, True and False.

    Unsupported are tags, several documents, duplicate keys, aliases of something else than a
    string, deep nesting and long strings.
    """
    try:
        return _Reader(yaml, yaml.parse(text, Loader=yaml.SafeLoader)).document()
    except yaml.YAMLError as error:
        reason = getattr(error, "problem", None) or getattr(error, "reason", None) or "unreadable"
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}: "
        raise OutlineError(f"{where}{str(reason)[:100]}") from None


class _Reader:
    """Reads the parser's events once."""

    def __init__(self, yaml: Any, events: Iterator[Any]) -> None:
        self._yaml = yaml
        self._events = events
        self._texts: dict[str, Any] = {}  # strings by their anchors

    def document(self) -> Any:
        next(self._events)  # of the stream
        event = next(self._events)
        if isinstance(event, self._yaml.StreamEndEvent):
            return None
        content = self._node(next(self._events), 0)
        next(self._events)
        end = next(self._events)
        if not isinstance(end, self._yaml.StreamEndEvent):
            raise _wrong(end, "a second document begins: one is enough")
        return content

    def _node(self, event: Any, depth: int) -> Any:
        if isinstance(event, self._yaml.AliasEvent):
            if event.anchor not in self._texts:
                raise _wrong(event, f"the alias {shown(event.anchor)} stands for no text before it")
            return self._texts[event.anchor]
        if event.tag is not None:
            raise _wrong(event, f"the tag {shown(event.tag)} has no meaning here: leave it away")
        if isinstance(event, self._yaml.ScalarEvent):
            return self._text(event)
        if depth == _DEEPEST:
            raise _wrong(event, f"nested deeper than {_DEEPEST} levels")
        if isinstance(event, self._yaml.SequenceStartEvent):
            return [self._node(inner, depth + 1) for inner in self._inner()]
        return self._mapping(depth)

    def _mapping(self, depth: int) -> dict[str, Any]:
        content: dict[str, Any] = {}
        for event in self._inner():
            key = self._node(event, depth + 1)
            if not isinstance(key, str):
                raise _wrong(event, f"a key must be a text, not {shown(key)}")
            if key in content:
                raise _wrong(event, f"the key {shown(key)} stands twice")
            content[key] = self._node(next(self._events), depth + 1)
        return content

    def _inner(self) -> Iterator[Any]:
        """Yield the events up to the end of a list or mapping."""
        for event in self._events:
            if isinstance(event, self._yaml.CollectionEndEvent):
                return
            yield event

    def _text(self, event: Any) -> Any:
        text = event.value
        if len(text) > _LONGEST_TEXT:
            raise _wrong(event, f"a text of {len(text)} characters: at most {_LONGEST_TEXT} fit")
        if not all(c.isprintable() or c.isspace() for c in text):
            raise _wrong(event, "a text with a character that cannot be printed")
        content = _WORDS.get(text, text) if event.implicit[0] else text
        if event.anchor is not None:
            self._texts[event.anchor] = content
        return content


def _wrong(event: Any, what: str) -> OutlineError:
    return OutlineError(f"line {event.start_mark.line + 1}: {what}")
