"""A chain dropped end first: the paper's impact with joints."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.experiment.drop import Drop, DropResult
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.trajectory import degrees
from mjgranular.models import Chain

GRAVITY = 9.81  # of models/link.xml, which chains are made from [m/s^2]


def chain_length(body: str) -> int | None:
    """N of "chain:N", None for other bodies.

    Raises:
        InputError: no number of links follows the colon.
    """
    word, colon, count = body.partition(":")
    if word != "chain":
        return None
    if not colon or not count.isdecimal() or int(count) < 1:
        raise InputError(f"a chain of N links is chain:N, such as chain:2, got {body!r}")
    return int(count)


def chain_drop(impact: Impact, count: int) -> Drop:
    """Return the drop of a straight chain that corresponds to the impact of a link.

    Args:
        impact: release, size of one link, sand, time step. All links have the angle, T is the lower
            end of the last, and the angular velocity is that of the whole chain.
        count: number of links.
    """
    chain = Chain(
        count=count, length=impact.length, diameter=impact.diameter, density=impact.density
    )
    qpos = chain.posed([impact.angle] * count)
    qpos[1] += impact.height
    # From the first link's C to T, along the chain.
    arm = (count - 0.5) * impact.length
    qvel = np.zeros(len(qpos))
    qvel[0] = impact.tangential_speed - impact.angular_velocity * arm * math.cos(impact.angle)
    qvel[1] = -impact.speed - impact.angular_velocity * arm * math.sin(impact.angle)
    qvel[1] += impact.timestep / 2 * GRAVITY  # half a step before release, as for the link
    qvel[2] = impact.angular_velocity
    return Drop(
        model=chain,
        medium=impact.medium,
        law=impact.law,
        scheme=impact.scheme_taken,
        memory=None if impact.memory is None else str(impact.memory),
        duration=impact.duration,
        timestep=impact.timestep,
        state=tuple(map(float, [*qpos, *qvel])),
        site=f"T{count - 1}",
    )


def chain_summary(impact: Impact, count: int, result: DropResult) -> dict[str, Any]:
    """Return the result with the keys of a link's impact, and a summary of each link."""
    stop = result.stop
    return {
        "body": f"chain:{count}",
        "law": result.law,
        "medium": impact.medium,
        "scheme": impact.scheme_taken,
        "timestep": result.timestep,
        "speed": impact.speed,
        "angle_deg": degrees(impact.angle),
        "stopping_time": None if stop is None else stop[0],
        "depth": float(result.depth[:, -1].max()) if stop is None else stop[1],
        "stopped": stop is not None,
        **{k: v for k, v in result.summary().items() if k in ("at_rest", "rest_time", "bodies")},
    }
