"""Copy finished runs to the policies that come with the package.

    python scripts/ship_policies.py runs/ChainSwim-v0-ppo-0 runs/ChainSwim-v0-ppo-1

The copy omits what only training needs, the optimizer's moments (two thirds of `policy.zip`), and
the description of the machine. It is kept only if its actions are bit-identical to the original's.
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import torch

from mjgranular._util.result_folder import CONFIG
from mjgranular.learn.policies import POLICY_FILES, SHIPPED, load_policy
from mjgranular.learn.run import POLICY, open_run


def copy_policy(original: Path, copy: Path) -> None:
    """Copy a file of Stable-Baselines3 without the optimizer's moments."""
    with zipfile.ZipFile(original) as old, zipfile.ZipFile(copy, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "system_info.txt":
                continue
            if name == "policy.optimizer.pth":
                state = torch.load(io.BytesIO(content), weights_only=True)
                buffer = io.BytesIO()
                torch.save(state | {"state": {}}, buffer)
                content = buffer.getvalue()
            # A fixed date: the same run gives the same file.
            new.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


def ship(folder: Path, to: Path) -> Path:
    """Copy one run; return its new path."""
    run = open_run(folder)
    target = to / run.environment.rpartition("/")[2] / f"{run.settings.algorithm}-{run.seed}"
    if target.exists():
        raise SystemExit(f"{target} exists: remove it first")
    part = target.with_name(f".{target.name}.part")  # for an atomic copy
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    for name in POLICY_FILES:
        if not (folder / name).is_file():
            raise SystemExit(f"{folder} lacks {name}: its training is not finished")
        if name == POLICY:
            copy_policy(folder / name, part / name)
        else:
            shutil.copyfile(folder / name, part / name)
    config = json.loads((part / CONFIG).read_text(encoding="utf-8"))
    config["versions"]["platform"] = config["versions"]["platform"].partition("-")[0]
    (part / CONFIG).write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")
    before, after = load_policy(folder / POLICY), load_policy(part)
    space = before.model.observation_space
    seen = np.random.default_rng(0).standard_normal((64, *space.shape))
    if not np.array_equal(before.act(seen, np.zeros(64)), after.act(seen, np.zeros(64))):
        raise SystemExit(f"the copy of {folder} does not act as the original")
    part.rename(target)
    return target


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--to", type=Path, default=SHIPPED)
    options = parser.parse_args()
    for folder in options.runs:
        print(ship(folder, options.to))
