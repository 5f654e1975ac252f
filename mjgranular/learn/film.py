"""Films of an agent."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np

from mjgranular.errors import drawing
from mjgranular.learn import environments
from mjgranular.learn.agents import Agent
from mjgranular.picture.video import Film


def frames_of_episode(
    env_id: str,
    arguments: Mapping[str, Any],
    make_agent: Callable[[Any], Agent],
    film: Film,
    *,
    seed: int,
    camera: str | None,
) -> tuple[Film, int, Iterator[np.ndarray]]:
    """Return the frames of an episode in real time, from its beginning, for `film.seconds` at most.

    Returns:
        The film with the size and rate of the frames, their largest number, and the frames.
    """
    env = environments.for_filming(
        env_id, arguments, width=film.width, height=film.height, camera=camera
    )
    with ExitStack() as until_made:
        until_made.callback(env.close)
        step_time = getattr(env.unwrapped, "dt", None)
        rate = 1 / step_time if step_time else env.metadata.get("render_fps") or film.fps
        every = max(1, math.ceil(rate / film.fps))  # steps from one frame to the next
        steps = math.ceil(film.seconds * rate)
        observation, _ = env.reset(seed=seed)
        first = _frame(env)
        height, width = first.shape[:2]
        agent = make_agent(env)
        until_filmed = until_made.pop_all()

    def frames(observation: np.ndarray) -> Iterator[np.ndarray]:
        with until_filmed:
            yield first
            for step in range(steps):
                action = agent.act(observation[None], np.array([step]))[0]
                observation, _, terminated, truncated, _ = env.step(action)
                if (step + 1) % every == 0:
                    yield _frame(env)
                if terminated or truncated:
                    break

    shown = replace(film, width=width, height=height, fps=rate / every)
    return shown, 1 + steps // every, frames(observation)


def _frame(env: Any) -> np.ndarray:
    with drawing("the environment cannot be drawn"):
        return np.asarray(env.render(), dtype=np.uint8)
