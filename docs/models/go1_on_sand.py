"""A task of mjlab on sand: the Go1 that follows commands, as its task `Sand-Go1`."""

from mjlab.tasks.registry import load_env_cfg, load_rl_cfg, load_runner_cls, register_mjlab_task

from mjgranular.envs.mjlab import on_sand

GO1 = "Mjlab-Velocity-Flat-Unitree-Go1"

register_mjlab_task(
    "Sand-Go1",
    on_sand(load_env_cfg(GO1), strength=(0.5, 2.0)),
    on_sand(load_env_cfg(GO1, play=True)),
    load_rl_cfg(GO1),
    load_runner_cls(GO1),
)

if __name__ == "__main__":
    from mjlab.scripts.train import main

    main()
