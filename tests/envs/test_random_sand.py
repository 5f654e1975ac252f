"""Sand that is drawn at each reset: where from, what it does, what is told."""

import importlib.util
import math
from dataclasses import dataclass, replace

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from mjgranular import InputError, Rft3dLaw, UnknownNameError, media, register_medium
from mjgranular.envs import SandEnv, SandRanges, SandVectorEnv, on_sand, tasks
from mjgranular.envs.ground import DUNES, Dunes
from mjgranular.envs.gym_robots import Hopper
from mjgranular.envs.ids import id_of
from mjgranular.medium.file import EXAMPLE

batches = pytest.mark.skipif(
    importlib.util.find_spec("mujoco.batch") is None, reason="a MuJoCo without batches"
)

EVERYTHING = SandRanges(
    strength=(0.5, 2.0),
    density=(0.8, 1.2),
    slope=(-0.1, 0.2),
    media=("quikrete_medium", "poppy_seed_loose"),
    laws=("rft3d",),
    surfaces=("plane", "dunes"),
)


def test_what_is_drawn_is_in_range_and_differs_and_is_told():
    env = SandEnv("Hexapod", randomise=EVERYTHING, observe_sand=True)
    env.reset(seed=0)
    seen = []
    for _ in range(40):
        observation, info = env.reset()
        for name in ("strength", "density", "slope"):
            low, high = getattr(EVERYTHING, name)
            assert low <= info[f"sand/{name}"] <= high
        # strength, density, slope, and which of the four it is
        told = [info[f"sand/{name}"] for name in ("strength", "density", "slope")]
        assert list(observation[-7:-4]) == told
        assert sorted(observation[-4:]) == [0, 0, 0, 1]
        number = int(np.argmax(observation[-4:]))
        choice = env.task.choices[number]
        assert (choice.medium, choice.law, choice.surface) == tuple(
            info[f"sand/{name}"] for name in ("medium", "law", "surface")
        )
        seen.append((*told, number))
    assert len({strength for strength, *_ in seen}) == 40
    assert {number for *_, number in seen} == {0, 1, 2, 3}
    slopes = [slope for _, _, slope, _ in seen]
    assert min(slopes) < -0.05
    assert max(slopes) > 0.15


def test_a_seed_decides_it():
    # The default laws of these two differ.
    ranges = SandRanges(strength=(0.5, 2.0), media=("quikrete_medium", "glass_beads"))
    first, second = (SandEnv("ChainSwim", randomise=ranges) for _ in range(2))
    laws = set()
    for seed in (0, None, None, 4, *range(5, 15)):
        one, other = first.reset(seed=seed)[1], second.reset(seed=seed)[1]
        assert one["sand/strength"] == other["sand/strength"]
        assert one["sand/medium"] == other["sand/medium"]
        laws.add(one["sand/law"])
    assert laws == {"rft3d_dynamic", "rft2d_dynamic"}


@batches
@pytest.mark.parametrize(
    "name",
    [
        "ChainSwim",
        "Hopper",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ChainCrawl", "Hexapod", "Ant")),
    ],
)
def test_a_batch_draws_what_single_environments_draw(name):
    options = {"randomise": EVERYTHING, "observe_sand": True, "max_episode_steps": 5}
    sync = gym.make_vec(id_of(name), num_envs=4, vectorization_mode="sync", **options)
    batch = gym.make_vec(id_of(name), num_envs=4, **options)
    first, second = sync.reset(seed=2), batch.reset(seed=2)
    sync.action_space.seed(0)
    for _ in range(14):
        assert np.array_equal(first[0], second[0])
        assert first[-1].keys() == second[-1].keys()
        for key, value in first[-1].items():
            assert np.array_equal(value, second[-1][key]), key
        actions = sync.action_space.sample()
        first, second = sync.step(actions), batch.step(actions)
        assert np.array_equal(first[1], second[1])


def test_strength_is_the_laws_own_scale():
    law = Rft3dLaw.from_medium(media["quikrete_medium"])
    drawn = SandEnv("Hopper", law=law, randomise=SandRanges(strength=(0.4, 0.4)))
    made = SandEnv("Hopper", law=replace(law, scale=0.4 * law.scale))
    plain = SandEnv("Hopper", law=law)
    ends = []
    for env in (drawn, made, plain):
        # The generator is asked for the sand first: the start itself is to be the same here.
        observation, _ = env.reset(seed=0)
        env.data.qpos[:], env.data.qvel[:] = env.model.qpos0, 0.0
        for _ in range(40):
            observation, *_ = env.step(np.zeros(3, np.float32))
        ends.append(observation)
    assert ends[0] == pytest.approx(ends[1], rel=1e-9, abs=1e-9)
    assert np.abs(ends[0] - ends[2]).max() > 1e-4


def test_slope_tilts_gravity_and_a_ball_rolls_down_nothing_else():
    env = SandEnv("Hexapod", randomise=SandRanges(slope=(0.2, 0.2)))
    env.reset(seed=0)
    gravity = env.model.opt.gravity
    assert np.linalg.norm(gravity) == pytest.approx(9.81, rel=1e-12)
    assert math.atan2(-gravity[0], -gravity[2]) == pytest.approx(0.2)  # uphill towards +x
    _, info = env.reset(seed=1)
    assert np.linalg.norm(gravity) == pytest.approx(9.81, rel=1e-12)
    for _ in range(25):
        *_, info = env.step(np.zeros(12, np.float32))
    weight = 9.81 * env.model.body_mass.sum()
    # It stands: the sand bears it along the normal and holds it along the slope.
    assert info["sand/force"][2] == pytest.approx(weight * math.cos(0.2), rel=0.05)
    assert info["sand/force"][0] == pytest.approx(weight * math.sin(0.2), rel=0.2)
    assert info["sand/valid"] is False  # the law is for level ground


def test_a_tilted_gravity_of_the_model_stays():
    @dataclass(frozen=True, kw_only=True)
    class OnHill(Hopper):
        def robot(self):
            spec = super().robot()
            spec.option.gravity = [-1.0, 0.5, -9.7]
            return spec

    env = SandEnv(OnHill(randomise=SandRanges(slope=(0.0, 0.2))))
    for slope, expected in ((0.0, [-1.0, 0.5, -9.7]), (0.2, [-2.9071591, 0.5, -9.3079765])):
        env.reset(seed=0, options={"slope": slope})
        np.testing.assert_allclose(env.model.opt.gravity, expected, rtol=1e-7)


def test_dunes_are_where_they_say():
    env = SandEnv("ChainCrawl", randomise=SandRanges(surfaces=("dunes",)))
    env.reset(seed=0)
    model, data, dunes = env.model, env.data, env.task.dunes
    geom = model.geom(DUNES).id
    for x, y in ((0.0, 0.0), (1.3, -0.4), (-7.2, 3.3)):
        start, down = np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0])
        away = mujoco.mj_rayHfield(model, data, geom, start, down, None)
        assert 5.0 - away == pytest.approx(dunes.height(x, y), abs=2e-3)
    heights = Dunes().heights()
    slope = np.hypot(*np.gradient(heights, 0.2))
    assert math.atan(slope.max()) <= Dunes().steepest + 1e-3
    assert math.atan(slope.max()) > 0.5 * Dunes().steepest
    assert env.reset(seed=0)[1]["sand/valid"] is True


@pytest.mark.parametrize(
    ("surface", "name"), [("plane slope=0.1", "plane"), ("height_field geom=dunes", "dunes")]
)
def test_each_medium_has_the_surface_of_the_environment(surface, name):
    media = ("quikrete_medium", "poppy_seed_loose")
    task = tasks["ChainCrawl"](surface=surface, randomise=SandRanges(media=media))
    assert [choice.surface for choice in task.choices] == [name, name]
    assert all(task.ground(number) is not None for number in range(2))


def test_dunes_of_every_episode_keep_prints():
    env = SandEnv("ChainCrawl", surface="height_field geom=dunes", memory=True)
    _, info = env.reset(seed=0)
    ground = env.task.ground(0)
    assert ground is not None
    assert ground(1.3, -0.4) == env.task.dunes.height(1.3, -0.4) != 0.0
    for _ in range(3):
        info = env.step(np.zeros(env.model.nu))[-1]
    assert info["sand/force"][2] > 0.0
    assert np.abs(env.data.plugin_state).max() > 0.0


@batches
@pytest.mark.parametrize("name", ["ChainCrawl", "Hexapod", "Hopper", "Walker2d", "Ant"])
def test_starts_are_on_the_dunes(name):
    batch = SandVectorEnv(name, 8, randomise=SandRanges(surfaces=("dunes",)))
    _, info = batch.reset(seed=0)
    level = SandEnv(name).reset(seed=0)[1]["sand/depth"]
    assert (info["sand/depth"] < max(level, 0.0) + 0.05).all()  # they are not level all over
    assert (info["sand/depth"] > level - 0.4).all()
    assert np.ptp(info["x_position"]) > 0.5  # at another place of them each time


def test_a_curriculum_is_asked_each_time():
    asked = []

    def harder(episode):
        asked.append(episode)
        return SandRanges(slope=(0.01 * episode, 0.01 * episode))

    env = SandEnv("ChainSwim", randomise=SandRanges(slope=(0.0, 0.3)), curriculum=harder)
    slopes = [env.reset(seed=i)[1]["sand/slope"] for i in range(4)]
    assert asked == [0, 1, 2, 3]
    assert slopes == pytest.approx([0.0, 0.01, 0.02, 0.03])


@batches
def test_a_batch_asks_a_curriculum_for_each_simulation():
    def harder(episode):
        return SandRanges(slope=(0.01 * episode, 0.01 * episode))

    ranges = SandRanges(slope=(0.0, 0.3))
    batch = SandVectorEnv("ChainSwim", 2, randomise=ranges, curriculum=harder, max_episode_steps=1)
    batch.reset(seed=0)
    batch.step(np.zeros((2, 6)))
    _, _, _, _, info = batch.step(np.zeros((2, 6)))
    assert info["sand/slope"] == pytest.approx([0.01, 0.01])


def test_a_reset_sets_the_sand_of_one_episode():
    env = gym.make(id_of("Hexapod"), randomise=EVERYTHING)
    asked = {"strength": 0.6, "slope": (0.1, 0.2), "media": ("poppy_seed_loose",)}
    for seed in range(4):
        _, info = env.reset(seed=seed, options=asked)
        assert info["sand/strength"] == 0.6
        assert 0.1 <= info["sand/slope"] <= 0.2
        assert info["sand/medium"] == "poppy_seed_loose"
    info = env.reset(seed=0, options={"media": "poppy_seed_loose"})[1]
    assert info["sand/medium"] == "poppy_seed_loose"
    assert env.reset(seed=3)[1]["sand/strength"] != 0.6
    same = gym.make(id_of("Hexapod"), randomise=EVERYTHING)
    assert np.array_equal(same.reset(seed=3)[0], env.reset(seed=3, options={})[0])
    with pytest.raises(InputError, match="media of reset have 'glass_beads', which randomise"):
        env.reset(options={"media": ("glass_beads",)})
    with pytest.raises(InputError, match="strength must be positive"):
        env.reset(options={"strength": -1.0})
    with pytest.raises(UnknownNameError, match=r"'strenght'.*strength"):
        env.reset(options={"strenght": 1.0})
    with pytest.raises(InputError, match=r"made with randomise=.*randomise=\{\}"):
        SandEnv("Hexapod").reset(options={"strength": 0.5})
    with pytest.raises(InputError, match="must be a dict by name, not a list"):
        env.reset(options=[1])
    fixed = SandEnv("Hexapod", randomise={})
    assert fixed.reset(seed=0, options={"density": 2})[1]["sand/density"] == 2.0


@batches
def test_a_reset_of_a_batch_sets_the_sand_of_those_that_begin():
    batch = SandVectorEnv("Hexapod", 3, randomise=EVERYTHING)
    batch.reset(seed=0)
    options = {"strength": 0.6, "reset_mask": np.array([True, False, True])}
    _, info = batch.reset(options=options)
    assert list(info["sand/strength"] == 0.6) == [True, False, True]
    assert set(options) == {"strength", "reset_mask"}
    with pytest.raises(UnknownNameError, match="strenght"):
        batch.reset(options={"strenght": 1.0})
    with pytest.raises(InputError, match="must be a dict by name"):
        batch.reset(options=[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strength": (2.0, 1.0)}, "strength has its low end above its high end"),
        ({"strength": (0.0, 1.0)}, "strength must be positive, not 0.0"),
        ({"strength": (1.0, 1e4)}, "strength is a factor and at most 100"),
        ({"strength": 2.0}, r"strength must be \(low, high\), not 2.0"),
        ({"density": (-1.0, 1.0)}, "density must not be negative, not -1.0"),
        ({"density": (1.0, math.nan)}, "density must be finite"),
        ({"slope": (0.0, 0.7)}, "slope must be within 0.593 rad"),
        ({"media": "play_sand"}, "media must be a tuple of names, not 'play_sand'"),
    ],
)
def test_ranges_that_cannot_be_are_named(options, message):
    with pytest.raises(InputError, match=message):
        SandRanges(**options)


def test_ranges_may_be_a_table_of_lists():
    table = {"strength": [0.5, 2], "media": ["quikrete_medium"]}
    ranges = SandRanges(strength=(0.5, 2.0), media=("quikrete_medium",))
    assert tasks["Hopper"](randomise=table).randomise == ranges
    one, other = (on_sand("Hopper-v5", randomise=each).reset(seed=0)[1] for each in (table, ranges))
    assert one["sand/strength"] == other["sand/strength"]


def test_media_may_be_files_and_laws_have_parameters(tmp_path, monkeypatch):
    monkeypatch.setattr(media, "_things", dict(media._things))
    file = tmp_path / "beach.yaml"
    file.write_text(EXAMPLE)
    mine = register_medium(replace(media["play_sand"], name="mine"))
    ranges = SandRanges(media=(str(file), mine.name), laws=("link_distributed pieces=5",))
    assert ranges.media == (str(file), "mine")
    env = gym.make("mjgranular/LinkDrop-v0", randomise=ranges)
    drawn = {env.reset(seed=seed)[1]["sand/medium"] for seed in range(10)}
    assert drawn == {str(file), "mine"}
    with pytest.raises(InputError, match="media must be names, got the medium 'mine'"):
        SandRanges(media=(mine,))


def test_the_medium_of_a_law_does_not_depend_on_other_laws():
    env = gym.make(
        "mjgranular/Hexapod-v0", medium=None, randomise={"laws": ("depth_velocity", "rft2d")}
    )
    choices = [(choice.medium, choice.law) for choice in env.unwrapped.task.choices]
    assert choices == [("glass_beads", "depth_velocity"), ("play_sand", "rft2d")]


def test_wrong_input_is_told():
    with pytest.raises(UnknownNameError, match=r"no medium 'mud'; there are: glass_beads, glass"):
        SandRanges(media=("mud",))
    with pytest.raises(UnknownNameError, match=r"no law 'wet'; there are: depth_velocity"):
        SandRanges(laws=("wet",))
    with pytest.raises(UnknownNameError, match=r"no surface 'sea'; there are: plane, dunes"):
        SandRanges(surfaces=("sea",))
    with pytest.raises(InputError, match="randomise takes a SandRanges"):
        SandEnv("Hopper", randomise=[1, 2])
    # Not a TypeError: Gymnasium's make raises such an error again, with one argument.
    with pytest.raises(UnknownNameError, match=r"no range of randomise 'strengh'.*strength"):
        gym.make("mjgranular/Hopper-v0", randomise={"strengh": (1, 2)})
    with pytest.raises(InputError, match="a curriculum needs randomise"):
        SandEnv("Hopper", curriculum=lambda episode: SandRanges())
    with pytest.raises(InputError, match="observe_sand needs randomise"):
        SandEnv("Hopper", observe_sand=True)
    with pytest.raises(UnknownNameError, match="no constants in medium 'play_sand' for law"):
        SandEnv("Hopper", randomise=SandRanges(media=("play_sand",), laws=("rft3d",)))
    env = SandEnv(
        "ChainSwim",
        randomise=SandRanges(media=("quikrete_medium",)),
        curriculum=lambda episode: SandRanges(media=("glass_beads",)),
    )
    with pytest.raises(InputError, match="media of the curriculum have 'glass_beads', which"):
        env.reset(seed=0)
    env = SandEnv(
        "ChainSwim",
        randomise=SandRanges(slope=(-0.1, 0.1)),
        curriculum=lambda episode: SandRanges(slope=(0.0, 0.3)),
    )
    with pytest.raises(InputError, match=r"slope of the curriculum must be within .*\(-0.1, 0.1\)"):
        env.reset(seed=0)


def test_gymnasiums_own_can_have_it_drawn_too():
    env = on_sand("Hopper-v5", randomise=SandRanges(strength=(0.5, 2.0), slope=(-0.1, 0.1)))
    first = env.reset(seed=0)[1]
    ours = gym.make(id_of("Hopper"), randomise=SandRanges(strength=(0.5, 2.0), slope=(-0.1, 0.1)))
    second = ours.reset(seed=0)[1]
    assert first.keys() == second.keys()
    assert first["sand/strength"] == second["sand/strength"]
    assert first["sand/slope"] == second["sand/slope"]
    with pytest.raises(InputError, match="on_sand draws no dunes"):
        on_sand("Hopper-v5", randomise=SandRanges(surfaces=("dunes",)))
    for _ in range(30):
        one, other = env.step(np.ones(3, np.float32)), ours.step(np.ones(3, np.float32))
        assert np.array_equal(one[0], other[0])
        assert one[1] == other[1]


def test_environments_of_one_task_have_models_of_their_own():
    task = tasks["Hopper"](randomise={"slope": (-0.2, 0.2)})
    one, other = SandEnv(task), SandEnv(task)
    one.reset(seed=0)
    before = one.model.opt.gravity.copy()
    other.reset(seed=1)
    assert np.array_equal(one.model.opt.gravity, before)
    assert not np.array_equal(other.model.opt.gravity, before)
