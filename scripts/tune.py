"""Tune the settings of a training with Optuna; each trial is a training run in a folder.

python scripts/tune.py mjgranular/ChainCrawl-v0 --trials 16 --total-steps 100000 --out tuned

The study is in DIR/study.db: the same command adds trials, also at once. `suggest` has the ranges.
"""

import argparse
from pathlib import Path
from typing import Any

from mjgranular._util.checks import check_count, require
from mjgranular.errors import GranularError, InputError, UnstableError
from mjgranular.learn import change, find_settings
from mjgranular.learn.evaluate import evaluate
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import begin_run
from mjgranular.learn.train import train

SEEDS = 20_000  # not those of training or of `mjgranular evaluate`


def suggest(trial: Any) -> list[str]:
    """Return changes of the settings for one trial. The ranges are chosen, not measured."""
    rate = trial.suggest_float("learning_rate", 1e-4, 1e-2, log=True)
    gamma = 1 - trial.suggest_float("1 - gamma", 5e-3, 1e-1, log=True)
    epochs = trial.suggest_int("n_epochs", 3, 10)
    return [f"learning_rate=linear_{rate:.4g}", f"gamma={gamma:.4g}", f"n_epochs={epochs}"]


def run_trial(trial: Any, options: argparse.Namespace) -> float:
    """Train and evaluate; return the mean return over ten seeds."""
    # Seeded for each trial: each process would suggest the same ones again.
    trial.study.sampler = type(trial.study.sampler)(seed=1000 * options.seed + trial.number)
    suggested = suggest(trial)
    trial.set_user_attr("set", " ".join([*options.set, *suggested]))
    settings = change(options.settings, [*suggested, f"total_steps={options.total_steps}"])
    run = begin_run(options.out / f"trial-{trial.number}", options.env, settings, seed=options.seed)
    with run.locked():
        if train(run).stopped_by is not None:
            raise KeyboardInterrupt
    policy, env = load_policy(run.path), options.env
    return evaluate(run.name, lambda _: policy, env, run.arguments, first_seed=SEEDS).returned.mean


def main() -> None:
    """Run the trials and print the best settings."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("env", help="Gymnasium id")
    parser.add_argument("--trials", type=int, default=16)
    parser.add_argument("--total-steps", type=int, default=100_000, help="of each trial")
    parser.add_argument("--set", nargs="*", default=[], help="fixed settings, as for train --set")
    parser.add_argument("--seed", type=int, default=0, help="of all trials and the sampler")
    parser.add_argument("--out", type=Path, default="tuned")
    options = parser.parse_args()
    name = f"{options.env} {options.total_steps} steps, seed {options.seed} {options.set}"
    try:
        check_count("--trials", options.trials)
        optuna = require("optuna", extra="tune", purpose="Tuning")
        options.settings = change(find_settings(options.env, algorithm="ppo"), options.set)
        options.out.mkdir(parents=True, exist_ok=True)
        storage = f"sqlite:///{options.out / 'study.db'}"
        if others := {*optuna.get_all_study_names(storage)} - {name}:
            raise InputError(f"{options.out} has trials of {min(others)}: use another --out")
        study = optuna.create_study(
            storage=storage, study_name=name, direction="maximize", load_if_exists=True
        )
        study.optimize(lambda trial: run_trial(trial, options), options.trials, catch=UnstableError)
        if not study.get_trials(states=[optuna.trial.TrialState.COMPLETE]):
            raise InputError("no trial was finished: all were unstable")
    except (GranularError, OSError, KeyboardInterrupt) as error:
        reason = str(error) or f"interrupted; the same command adds to {options.out}"
        raise SystemExit(f"error: {reason}") from None
    best = study.best_trial
    print(f"best of {len(study.trials)}: trial-{best.number}, mean return {best.value:.4g}")
    print(f"--set {best.user_attrs['set']}")


if __name__ == "__main__":
    main()
