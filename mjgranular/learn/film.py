"""Films of an agent, MP4 or GIF."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.extras import require
from mjgranular._util.files import atomic_write
from mjgranular.errors import GranularError, InputError, RenderError
from mjgranular.learn import environments
from mjgranular.learn.agents import Agent
from mjgranular.picture.video import Film

_CODECS: dict[str, dict[str, Any]] = {
    ".mp4": {"codec": "h264", "crf": 20},
    ".gif": {"codec": "gif"},
}


def film_episode(
    path: Path,
    env_id: str,
    arguments: Mapping[str, Any],
    make_agent: Callable[[Any], Agent],
    film: Film,
    *,
    seed: int,
    camera: str | None,
    progress: Callable[[int], object] | None = None,
) -> float:
    """Film one episode in real time, from its beginning, for `film.seconds` at most.

    Args:
        path: path of the file; .mp4 or .gif.
        env_id: Gymnasium id.
        arguments: arguments of the environment.
        make_agent: returns the agent for a given environment.
        film: size, frames per second, length.
        seed: seed of the environment's reset.
        camera: camera of the model; None for the environment's default view.
        progress: called with the number of frames rendered.

    Returns:
        The return up to the film's end.

    Raises:
        InputError: another file extension, or no such camera.
        RenderError: the environment cannot be drawn on this machine.
    """
    if path.suffix not in _CODECS:
        raise InputError(f"a film must be written as .mp4 or .gif, got {path.name!r}")
    mediapy = require("mediapy", extra="video", purpose="Writing a video")
    ffmpeg = require("imageio_ffmpeg", extra="video", purpose="Writing a video")
    mediapy.set_ffmpeg(ffmpeg.get_ffmpeg_exe())
    env = environments.for_filming(
        env_id, arguments, width=film.width, height=film.height, camera=camera
    )
    try:
        agent = make_agent(env)
        step_time = getattr(env.unwrapped, "dt", None)
        rate = 1 / step_time if step_time else env.metadata.get("render_fps") or film.fps
        every = max(1, math.ceil(rate / film.fps))  # steps from one frame to the next
        observation, _ = env.reset(seed=seed)
        frames, total, step, over = [_frame(env)], 0.0, 0, False
        while not over and step < film.seconds * rate:
            action = agent.act(observation[None], np.array([step]))[0]
            observation, reward, terminated, truncated, _ = env.step(action)
            total += float(reward)
            step += 1
            over = terminated or truncated
            if step % every == 0:
                frames.append(_frame(env))
                if progress is not None:
                    progress(len(frames))
    finally:
        env.close()
    with atomic_write(path) as part:
        mediapy.write_video(part, frames, fps=rate / every, **_CODECS[path.suffix])
    return total


def _frame(env: Any) -> np.ndarray:
    try:
        return np.asarray(env.render(), dtype=np.uint8)
    except GranularError:
        raise
    except Exception as error:  # each platform's GL fails differently
        raise RenderError(
            f"the environment cannot be drawn ({type(error).__name__}: {error}); on Linux without "
            "a screen install libegl1 (apt-get install libegl1 libgl1-mesa-dri), import mjgranular "
            "before mujoco, or set MUJOCO_GL=egl"
        ) from None
