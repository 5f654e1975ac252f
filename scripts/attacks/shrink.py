"""Find a smaller model that fails the same check, with hypothesis.

Hypothesis chooses which elements of the model and which events are kept: an integer is seldom 0 at
random, and shrinks to 0, which omits the part.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import replace

import hypothesis
from attacks.cases import ModelCase
from hypothesis import strategies as st
from hypothesis.errors import NoSuchExample

_SECTIONS = ("worldbody", "equality", "tendon", "actuator", "asset")
_SETTINGS = hypothesis.settings(max_examples=100, database=None, deadline=None)


def smaller(case: ModelCase, fails: Callable[[ModelCase], bool]) -> ModelCase:
    """Return a part of the case that fails as the whole does; the case itself if there is none."""
    count = len(_elements(ET.fromstring(case.xml))) + len(case.events)
    parts = st.lists(st.integers().map(bool), min_size=count, max_size=count)
    try:
        kept = hypothesis.find(parts, lambda kept: fails(part_of(case, kept)), settings=_SETTINGS)
    except NoSuchExample:
        return case
    return part_of(case, kept)


def part_of(case: ModelCase, kept: Sequence[bool]) -> ModelCase:
    """Return the case with the kept elements and events."""
    root, sand = ET.fromstring(case.xml), case.sand
    elements = _elements(root)
    for (parent, element), keep in zip(elements, kept, strict=False):
        if not keep:
            parent.remove(element)
            for each in element.iter():
                sand = re.sub(rf"'{each.get('name')}'(, )?", "", sand)
    events = zip(case.events, kept[len(elements) :], strict=True)
    return replace(
        case,
        xml=ET.tostring(root, encoding="unicode"),
        sand=sand,
        events=[event for event, keep in events if keep],
    )


def _elements(root: ET.Element) -> list[tuple[ET.Element, ET.Element]]:
    """List the elements that may be removed, with their parents."""
    sections = [section for section in root if section.tag in _SECTIONS]
    return [(parent, each) for section in sections for parent in section.iter() for each in parent]
