"""Exponential and logarithm against those of the mathematical library."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjgranular.kernel import compiled
from mjgranular.kernel.elementary import exponential, logarithm

CLOSE = 1e-15  # measured: at most 4.5e-16, two units of the last place


@given(x=st.floats(-690, 690))
def test_the_exponential_is_that_of_the_library(x):
    assert exponential(x) == pytest.approx(math.exp(x), rel=CLOSE)


@given(x=st.floats(1e-300, 1e300))
def test_the_logarithm_is_that_of_the_library(x):
    assert logarithm(x) == pytest.approx(math.log(x), rel=CLOSE, abs=1e-18)


def test_a_million_of_each():
    rng = np.random.default_rng(0)

    @compiled
    def worst_of(x, exact, most):
        for i in range(len(x)):
            most[0] = max(most[0], abs(exponential(x[i]) / exact[i] - 1.0))
            most[1] = max(most[1], abs(logarithm(exact[i]) - x[i]))

    x, most = rng.uniform(-5, 5, 10**6), np.zeros(2)
    worst_of(x, np.exp(x), most)
    assert most[0] < CLOSE
    assert most[1] < 5 * CLOSE


def test_their_ends():
    assert exponential(0.0) == 1.0
    assert logarithm(1.0) == 0.0
    assert exponential(-1e9) == pytest.approx(math.exp(-700))
    assert exponential(1e9) == pytest.approx(math.exp(700))
