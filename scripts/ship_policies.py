"""Copies finished runs to where the policies that come with the package lie.

    python scripts/ship_policies.py runs/ChainSwim-v0-ppo-0 runs/ChainSwim-v0-ppo-1

It omits from `policy.zip` what only training needs, the optimizer's moments (two thirds of the
file), and the machine's description. The actions of a copy must be bit-identical to those of the
original, or it is not kept.
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import torch

from mjgranular._util.result_folder import CONFIG
from mjgranular.learn.policies import POLICY_FILES, SHIPPED, load_policy
from mjgranular.learn.run import POLICY, open_run

_OPTIMISER = "policy.optimizer.pth"
_MACHINE = "system_info.txt"


def slim(original: Path, copy: Path) -> None:
    """Copy a file of Stable-Baselines3 without the optimizer's moments."""
    with zipfile.ZipFile(original) as old, zipfile.ZipFile(copy, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == _MACHINE:
                continue
            if name == _OPTIMISER:
                state = torch.load(io.BytesIO(content), weights_only=True)
                state["state"] = {}
                buffer = io.BytesIO()
                torch.save(state, buffer)
                content = buffer.getvalue()
            # A fixed date: the same run gives the same file.
            new.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


def ship(folder: Path, to: Path) -> Path:
    """Copy one run; return its new path."""
    run = open_run(folder)
    missing = [name for name in POLICY_FILES if not (folder / name).is_file()]
    if missing:
        raise SystemExit(f"{folder} lacks {', '.join(missing)}: its training is not finished")
    there = to / run.environment.rpartition("/")[2] / f"{run.settings.algorithm}-{run.seed}"
    if there.exists():
        raise SystemExit(f"{there} is there already: remove it first")
    part = there.with_name(f".{there.name}.part")  # for an atomic copy
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    for name in POLICY_FILES:
        if name == POLICY:
            slim(folder / name, part / name)
        elif name == CONFIG:
            config = json.loads((folder / name).read_text(encoding="utf-8"))
            system, *_ = config["versions"]["platform"].split("-")
            config["versions"]["platform"] = system
            (part / name).write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")
        else:
            shutil.copyfile(folder / name, part / name)
    before, after = load_policy(folder / POLICY), load_policy(part)
    space = before.model.observation_space
    seen = np.random.default_rng(0).standard_normal((64, *space.shape))
    if not np.array_equal(before.act(seen, np.zeros(64)), after.act(seen, np.zeros(64))):
        shutil.rmtree(part)
        raise SystemExit(f"the copy of {folder} does not act as the original")
    part.rename(there)
    return there


def main() -> int:
    """Copy the given runs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--to", type=Path, default=SHIPPED)
    options = parser.parse_args()
    for folder in options.runs:
        there = ship(folder, options.to)
        size = sum(file.stat().st_size for file in there.iterdir())
        print(f"{there}: {size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
