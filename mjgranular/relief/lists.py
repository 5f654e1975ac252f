"""Labels of nodes and lists of places in the state: places under bodies, and where sand flows.

Counts and places are treated as untrusted numbers: none may lead outside the state.
"""

from __future__ import annotations

from functools import partial

from mjgranular.kernel.compiled import compiled
from mjgranular.relief.grid import (
    ACTIVE,
    COVERED,
    FLOWS,
    FORGOTTEN,
    HEIGHT,
    KEY,
    LISTS,
    UNDER,
    UNMARKED,
    WAS_UNDER,
    add_height,
    mark_at,
    set_mark,
    start_of,
)


@partial(compiled, inline=True)
def count_at(state, size, number):
    """Return the length of a list: `COVERED` or `ACTIVE`."""
    return min(max(int(state[number]), 0), size * size)


@partial(compiled, inline=True)
def listed_at(state, size, n):
    """Return entry `n` of the lists, a place."""
    n = min(max(n, 0), size * size - 1)
    return min(max(int(state[start_of(size, LISTS) + n]), 0), size * size - 1)


@partial(compiled, inline=True)
def is_full(state, size):
    """Return True if the lists are full."""
    return state[COVERED] + state[ACTIVE] >= size * size


@compiled
def claim(state, size, blocks, area, k, base):
    """Assign place k to the node with the key `base`; the height that was there is forgotten."""
    height = state[start_of(size, HEIGHT) + k]
    state[FORGOTTEN] += area * height
    add_height(state, size, blocks, k, -height)
    state[start_of(size, HEIGHT) + k] = 0.0
    # A place where sand may flow is in a list.
    mark = FLOWS if mark_at(state, size, k) == FLOWS else UNMARKED
    state[start_of(size, KEY) + k] = base + mark


@compiled
def activate(state, size, k):
    """Let sand flow at a place, from the next step on."""
    if mark_at(state, size, k) == UNMARKED and not is_full(state, size):
        count = count_at(state, size, ACTIVE)
        state[start_of(size, LISTS) + size * size - 1 - count] = k
        state[ACTIVE] = count + 1.0
        set_mark(state, size, k, FLOWS)


@compiled
def cover(state, size, k):
    """Label a place as under a body; it is listed once per step."""
    mark = mark_at(state, size, k)
    if mark != UNDER and not is_full(state, size):
        count = count_at(state, size, COVERED)
        state[start_of(size, LISTS) + count] = k
        state[COVERED] = count + 1.0
        set_mark(state, size, k, UNDER)


@compiled
def begin_covering(state, size):
    """Label places that were under bodies; return their number. They are listed first."""
    before = count_at(state, size, COVERED)
    for n in range(before):
        k = listed_at(state, size, n)
        if mark_at(state, size, k) == UNDER:
            set_mark(state, size, k, WAS_UNDER)
    return before


@compiled
def end_covering(state, size, before):
    """Let sand flow where bodies have left, and keep only places that are under bodies now."""
    count, lists = count_at(state, size, COVERED), start_of(size, LISTS)
    for n in range(before):
        k = listed_at(state, size, n)
        if mark_at(state, size, k) == WAS_UNDER:
            set_mark(state, size, k, UNMARKED)
            activate(state, size, k)
    for n in range(before, count):
        state[lists + n - before] = state[lists + n]
    state[COVERED] = 1.0 * max(count - before, 0)
