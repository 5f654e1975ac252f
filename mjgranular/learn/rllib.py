"""What RLlib is given: a policy of Stable-Baselines3, and the rules by which that one learns.

The net, its optimiser and its distributions are those of Stable-Baselines3 themselves, so that what
RLlib has learned is a policy as any other, and may go on on either engine. RLlib samples, keeps
workers alive, estimates advantages and goes through minibatches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import torch
from ray.rllib.algorithms.ppo import PPO
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.distribution.torch.torch_distribution import TorchCategorical, TorchDiagGaussian
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule
from ray.rllib.evaluation.postprocessing import Postprocessing
from stable_baselines3.common.distributions import CategoricalDistribution

from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.scaling import ScaledEnvs, Scaling, Statistics
from mjgranular.learn.settings import Settings
from mjgranular.learn.weights import new_policy
from mjgranular.pool.versions import mismatch, versions

_KL = 1.5  # Stable-Baselines3 ends the epochs at so many times target_kl
_EPSILON = 1e-8  # added to the deviation of advantages, there too


class SandModule(TorchRLModule, ValueFunctionAPI):
    """A policy of Stable-Baselines3 with its critic; `model_config` has the settings of the run."""

    def setup(self) -> None:
        settings = Settings.from_json(self.model_config["settings"])
        self.policy = new_policy(settings, self.observation_space, self.action_space)
        discrete = isinstance(self.policy.action_dist, CategoricalDistribution)
        self.action_dist_cls = TorchCategorical if discrete else TorchDiagGaussian
        self._every = 0  # steps for which noise that depends on the state is kept
        if settings.arguments.get("use_sde", False):
            self._every = int(settings.arguments.get("sde_sample_freq", -1))
        self._steps = 0

    def begin_rollout(self, num_envs: int) -> None:
        """Draws the noise of a rollout anew, where it depends on the state."""
        self._steps = 0
        if self._every:
            self.policy.reset_noise(num_envs)

    def _forward(self, batch: Mapping[str, Any], **_: Any) -> dict[str, Any]:
        return {Columns.ACTION_DIST_INPUTS: _inputs(self.policy.get_distribution(batch["obs"]))}

    def _forward_exploration(self, batch: Mapping[str, Any], **_: Any) -> dict[str, Any]:
        observations = batch[Columns.OBS]
        if self._every > 0 and self._steps and self._steps % self._every == 0:
            self.policy.reset_noise(len(observations))
        self._steps += 1
        with torch.no_grad():
            distribution = self.policy.get_distribution(observations)
            actions = distribution.get_actions()
            return {
                Columns.ACTIONS: actions,
                Columns.ACTION_LOGP: distribution.log_prob(actions),
                Columns.ACTION_DIST_INPUTS: _inputs(distribution),
            }

    def compute_values(self, batch: Mapping[str, Any], embeddings: Any = None) -> torch.Tensor:
        return self.policy.predict_values(batch[Columns.OBS]).squeeze(-1)


def _inputs(distribution: Any) -> torch.Tensor:
    """What RLlib's distributions are made from; these are PyTorch's own, also with gSDE."""
    inner = distribution.distribution
    if isinstance(distribution, CategoricalDistribution):
        return inner.logits
    return torch.cat([inner.mean, inner.stddev.log()], dim=-1)


class SandLearner(PPOTorchLearner):
    """PPO by the rules of Stable-Baselines3 where RLlib has others.

    Advantages are standardised in each minibatch, and the epochs of a rollout end where the policy
    has gone too far from the one that sampled (`target_kl`).
    """

    _too_far = False

    def configure_optimizers_for_module(self, module_id: str, config: Any = None) -> None:
        module: Any = self.module[module_id].unwrapped()
        policy = module.policy
        self.register_optimizer(
            module_id=module_id,
            optimizer=policy.optimizer,
            params=list(policy.parameters()),
            lr_or_lr_schedule=config.lr,
        )

    def before_gradient_based_update(self, *, timesteps: dict[str, Any]) -> None:
        super().before_gradient_based_update(timesteps=timesteps)
        self._too_far = False

    def compute_loss_for_module(
        self, *, module_id: str, config: Any, batch: dict[str, Any], fwd_out: dict[str, Any]
    ) -> Any:
        there = batch[Columns.LOSS_MASK]  # not the steps that RLlib adds for the critic
        advantages = batch[Postprocessing.ADVANTAGES]
        known = advantages[there]
        standardised = (advantages - known.mean()) / (known.std() + _EPSILON)
        batch = {**batch, Postprocessing.ADVANTAGES: standardised}
        target = config.learner_config_dict["target_kl"]
        if target is not None and not self._too_far:
            self._too_far = self._distance(module_id, batch, fwd_out) > _KL * target
        return super().compute_loss_for_module(
            module_id=module_id, config=config, batch=batch, fwd_out=fwd_out
        )

    def compute_gradients(self, loss_per_module: Any, **kwargs: Any) -> Any:
        return {} if self._too_far else super().compute_gradients(loss_per_module, **kwargs)

    def postprocess_gradients(self, gradients_dict: Any) -> Any:
        return {} if self._too_far else super().postprocess_gradients(gradients_dict)

    def apply_gradients(self, gradients_dict: Any) -> None:
        if not self._too_far:
            super().apply_gradients(gradients_dict)

    def _distance(self, module_id: str, batch: Any, fwd_out: Any) -> float:
        """Divergence from the policy that sampled, http://joschu.net/blog/kl-approx.html."""
        kind = self.module[module_id].unwrapped().get_train_action_dist_cls()
        now = kind.from_logits(fwd_out[Columns.ACTION_DIST_INPUTS]).logp(batch[Columns.ACTIONS])
        with torch.no_grad():
            ratio = (now - batch[Columns.ACTION_LOGP])[batch[Columns.LOSS_MASK]]
            return float(((torch.exp(ratio) - 1) - ratio).mean())


class SandPPO(PPO):
    """PPO whose workers know the statistics of all."""

    statistics: Statistics
    """Given by whoever trains, before the first rollout."""
    last: Mapping[str, Any] = MappingProxyType({})
    """What the last rollout and the updates from it gave."""

    def begin_rollout(self) -> None:
        """Gives the statistics to all workers, and draws noise anew."""
        self._each(partial(_begin_rollout, statistics=self.statistics))

    def take(self) -> list[tuple[Statistics, list[tuple[float, int]]]]:
        """What workers have seen: statistics, and return and length of episodes."""
        return self._each(_take)

    def restore_env_runners(self, env_runner_group: Any) -> list[int]:
        restored = super().restore_env_runners(env_runner_group)
        if restored:  # they are new, and know nothing
            self.begin_rollout()
        return restored

    def weights(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """State of the policy and of its optimiser."""
        return self._learner(_weights)

    def set_weights_of(self, model: Any) -> None:
        """Goes on from a model of Stable-Baselines3."""
        states = model.policy.state_dict(), model.policy.optimizer.state_dict()
        self._learner(partial(_set_weights, states=states))
        # `sync_weights` would do nothing: workers compare counts of updates, and there was none.
        self._each(partial(_set_policy, state=states[0]))

    def _each(self, function: Callable[[Any], Any]) -> list[Any]:
        group: Any = self.env_runner_group
        return group.foreach_env_runner(function, local_env_runner=False)

    def _learner(self, function: Callable[[Any], Any]) -> Any:
        group: Any = self.learner_group
        (found,) = group.foreach_learner(function)
        return found.get()


def make_envs(given: Mapping[str, Any]) -> ScaledEnvs:
    """The environments of one worker. Workers share no register: what is named is imported here.

    Args:
        given: `environment`, `arguments`, `scaling`, `versions` of the process that trains, and
            `num_envs`.

    Raises:
        InputError: other versions are installed here.
    """
    different = mismatch(given["versions"], versions())
    if different is not None:
        raise InputError(f"a worker has other versions: {different}; install the same on all nodes")
    env = environments.several(
        given["environment"], given["arguments"], num_envs=given.get("num_envs", 1), threads=1
    )
    return ScaledEnvs(env, Scaling(*given["scaling"]))


def _scaled(runner: Any) -> ScaledEnvs:
    env = runner.env
    while not isinstance(env, ScaledEnvs):
        env = env.env
    return env


def _begin_rollout(runner: Any, statistics: Statistics) -> None:
    env = _scaled(runner)
    env.known = statistics
    runner.module.begin_rollout(env.num_envs)


def _take(runner: Any) -> tuple[Statistics, list[tuple[float, int]]]:
    return _scaled(runner).take()


def _set_policy(runner: Any, state: dict[str, Any]) -> None:
    runner.module.policy.load_state_dict(state)


def _policy(learner: Any) -> Any:
    return learner.module[DEFAULT_MODULE_ID].unwrapped().policy


def _weights(learner: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    policy = _policy(learner)
    return policy.state_dict(), policy.optimizer.state_dict()


def _set_weights(learner: Any, states: tuple[dict[str, Any], dict[str, Any]]) -> None:
    policy = _policy(learner)
    policy.load_state_dict(states[0])
    policy.optimizer.load_state_dict(states[1])
