"""Robots by name: their MJCF, from MuJoCo Menagerie or from a folder."""

import os
from pathlib import Path

from mjgranular._util.checks import check_name, kind_of, require
from mjgranular.errors import InputError, MissingExtraError

ROOT = "MENAGERIE_ROOT"
"""Environment variable, also of the package `mujoco-menagerie`: a folder of folders of robots."""


def robot_path(robot: str | Path) -> Path:
    """Return the path of a robot's MJCF file, without a floor.

    The folder `ROOT` is searched, then `mujoco-menagerie` downloads a robot on first use.

    Args:
        robot: a name of MuJoCo Menagerie, such as "unitree_go1"; or a path, returned unchanged.

    Raises:
        UnknownNameError: MuJoCo Menagerie has no such robot; lists those it has.
        InputError: the robot cannot be downloaded, or `robot` is neither a name nor a path.
    """
    if not isinstance(robot, (str, Path)):
        raise InputError(f"a robot must be a name or a path, not {kind_of(robot)}")
    name = str(robot)
    if not (name.isidentifier() and name.islower()) or Path(name).exists():
        return Path(robot)
    file = f"{name}/{name.rpartition('_')[2]}.xml"  # unitree_go1/go1.xml
    remedy = f"give the path of its MJCF, or set {ROOT} to a folder that has {file}"
    root = os.environ.get(ROOT)
    if root and (Path(root) / file).is_file():
        return Path(root) / file
    try:
        menagerie = require(
            "mujoco_menagerie", extra="robots", purpose=f"Downloading the robot {name}"
        )
    except MissingExtraError as error:
        raise InputError(f"{error}; or {remedy}") from None
    check_name("robot", name, menagerie.names())
    found = menagerie.get(name)
    try:
        return Path(found.path(progress=None)) / found.entry(found.default_model).file
    except (menagerie.MenagerieError, OSError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"cannot get the robot {name}: {reason}; {remedy}") from None
