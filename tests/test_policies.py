"""The policies that come with the package: they load, act, and do what the tables say."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

from mjgranular.learn.agents import make_baseline
from mjgranular.learn.evaluate import FIRST_SEED
from mjgranular.learn.policies import POLICY_FILES, SHIPPED, load_policy, shipped_policies

NAMES = list(shipped_policies())
