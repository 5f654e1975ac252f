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

_PURPOSE = "Writing a video"
ENDINGS = (".mp4", ".gif")


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
    if path.suffix not in ENDINGS:
        raise InputError(f"a film is written as .mp4 or .gif, not {path.suffix or path.name!r}")
    mediapy = require("mediapy", extra="video", purpose=_PURPOSE)
    ffmpeg = require("imageio_ffmpeg", extra="video", purpose=_PURPOSE)
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
        pictures, total, step, over = [_picture(env)], 0.0, 0, False
        while not over and step < film.seconds * rate:
            action = agent.act(observation[None], np.array([step]))[0]
            observation, reward, ended, cut, _ = env.step(action)
            total += float(reward)
            step += 1
            over = ended or cut
            if step % every == 0:
                pictures.append(_picture(env))
                if progress is not None:
                    progress(len(pictures))
    finally:
        env.close()
    codec = {"codec": "gif"} if path.suffix == ".gif" else {"codec": "h264", "crf": 20}
    with atomic_write(path) as part:
        mediapy.write_video(part, pictures, fps=rate / every, **codec)
    return total


def _picture(env: Any) -> np.ndarray:
    gym = require("gymnasium", extra="train", purpose=_PURPOSE)
    try:
        picture = env.render()
    except GranularError:
        raise
    except gym.error.DependencyNotInstalled as error:
        raise RenderError(f"the environment cannot be drawn: {error}") from None
    except Exception as error:  # each platform's GL fails differently
        raise RenderError(
            f"the environment cannot be drawn on this machine ({type(error).__name__}: {error}); "
            "on Linux without a screen install libegl1 (apt-get install libegl1 libgl1-mesa-dri), "
            "import mjgranular before mujoco, or set MUJOCO_GL=egl yourself"
        ) from None
    return np.asarray(picture, dtype=np.uint8)
