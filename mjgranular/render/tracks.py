"""Record of a sand's memory over a run, for a video."""

from dataclasses import dataclass, fields
from typing import Self

import mujoco
import numpy as np

from mjgranular.relief.grid import HEADER, HEIGHT, KEY, node_keys, nodes_of
from mjgranular.relief.memory import Memory
from mjgranular.sand import Sand

_INSTANTS = 400  # samples of a run; chosen: heights are interpolated linearly between them
_STEPS = 1e-3  # of a cell: a smaller change is not stored


@dataclass(frozen=True)
class Tracks:
    """Heights of the sand at some instants of a run, as changes from one to the next."""

    t: np.ndarray  # the instants [s], shape (n,)
    end: np.ndarray  # number of changes up to each instant, included, shape (n,)
    node: np.ndarray  # changed node (i, j), shape (m, 2), int32
    # Height of the sand over the surface there, from then on [m], shape (m,), float32
    height: np.ndarray

    @staticmethod
    def names() -> tuple[str, ...]:
        """Names of the arrays in a file."""
        return tuple(f"prints_{field.name}" for field in fields(Tracks))

    def change(self, begin: float, end: float) -> bool:
        """Return True if heights change between two times [s]."""
        first, last = np.searchsorted(self.t, (begin, end), side="right")
        last = min(int(last), len(self.t) - 1)
        return bool(first <= last and self.end[last] > (self.end[first - 1] if first else 0))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by their names in a file."""
        return {f"prints_{name}": value for name, value in vars(self).items()}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Self:
        """Restore the tracks that `arrays` returned."""
        found = cls(*(arrays[name] for name in cls.names()))
        t, end, node, height = found.t, found.end, found.node, found.height
        steady = end.dtype.kind in "iu" and (np.diff(end, prepend=0) >= 0).all()
        if t.ndim != 1 or end.shape != t.shape or not steady or (np.diff(t) <= 0).any():
            raise ValueError("instants of the prints are damaged")
        count = int(end[-1]) if len(end) else 0
        if node.shape != (count, 2) or height.shape != (count,) or node.dtype.kind != "i":
            raise ValueError("heights of the prints are damaged")
        if not np.isfinite(height).all() or (np.abs(node) >= 1 << 20).any():
            raise ValueError("heights of the prints must be finite")
        return found


class TrackRecorder:
    """Record the tracks of a run while it is simulated, from its beginning on."""

    def __init__(self, sand: Sand, data: mujoco.MjData, duration: float) -> None:
        assert sand.memory is not None
        self._sand, self._data, self._memory = sand, data, sand.memory
        self._apart, self._next = duration / _INSTANTS, 0.0
        self._last = np.zeros((2, sand.memory.size**2))  # heights, and keys without labels
        self._t: list[float] = []
        self._changes: list[tuple[np.ndarray, np.ndarray]] = []
        self.look(0.0)

    def look(self, t: float, *, last: bool = False) -> None:
        """Sample the sand if a sample is due."""
        if t < self._next and not last:
            return
        self._next = t + self._apart
        if self._t and t <= self._t[-1]:
            return
        state = self._sand.save_memory(self._data)[HEADER:]
        state = state[: self._last.size].reshape(self._last.shape)
        places = np.flatnonzero((state != self._last).any(axis=0))
        (before, keys_before), (now, keys) = self._last[:, places], state[:, places]
        now, keys = now.astype(np.float32), 4 * (keys // 4)
        changed = np.abs(now - before) > _STEPS * self._memory.cell
        changed |= ((now == 0) != (before == 0)) | ((keys != keys_before) & (now != 0))
        now, keys = now[changed], keys[changed]
        self._last[:, places[changed]] = now, keys
        nodes = np.stack(nodes_of(keys.astype(np.int64) // 4), axis=1).astype(np.int32)
        self._t.append(t)
        self._changes.append((nodes, now))

    def prints(self) -> Tracks:
        return Tracks(
            np.array(self._t),
            np.cumsum([len(heights) for _, heights in self._changes], dtype=np.int64),
            np.concatenate([np.zeros((0, 2), np.int32), *(nodes for nodes, _ in self._changes)]),
            np.concatenate([np.zeros(0, np.float32), *(heights for _, heights in self._changes)]),
        )


class Replay:
    """Heights at any time of a run, as the `state` of a memory (`relief.grid`) at a `time` [s]."""

    def __init__(self, prints: Tracks, memory: Memory) -> None:
        self._prints, self._size = prints, memory.size
        self.state = np.zeros(memory.state_size)
        self.time = 0.0
        self._last = np.zeros(memory.state_size)  # the state at the last instant
        self._done = 0  # instants up to it

    def to(self, t: float) -> np.ndarray:
        """Return the state at a time [s], with heights interpolated linearly between instants."""
        prints, self.time = self._prints, t
        done = int(np.searchsorted(prints.t, t, side="right"))
        if done < self._done:
            self._last[:], self._done = 0.0, 0
        while self._done < done:
            self._change(self._last, self._done, 1.0)
            self._done += 1
        self.state[:] = self._last
        if 0 < done < len(prints.t):
            share = (t - prints.t[done - 1]) / (prints.t[done] - prints.t[done - 1])
            self._change(self.state, done, share)
        return self.state

    def _change(self, state: np.ndarray, number: int, share: float) -> None:
        """Apply a share of what an instant changes to the state at the one before."""
        prints, size = self._prints, self._size
        begin = int(prints.end[number - 1]) if number else 0
        i, j = prints.node[begin : int(prints.end[number])].T.astype(np.int64)
        keys = 4.0 * node_keys(i, j)
        later, places = prints.height[begin : int(prints.end[number])], (i % size) * size + j % size
        all_heights, all_keys = (
            state[HEADER + k * size * size :][: size * size] for k in (HEIGHT, KEY)
        )
        before = np.where(all_keys[places] == keys, all_heights[places], 0.0)
        all_keys[places] = keys
        all_heights[places] = later if share == 1.0 else before + share * (later - before)
