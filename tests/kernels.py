"""The kernels of a law, called from Python with arrays of numbers."""

from functools import cache

import numpy as np
from numba import njit

from mjgranular.kernel.fields import column, packed, size_of
from mjgranular.kernel.motion import read_motion
from mjgranular.kernel.vector import read_matrix, read_vector, vector, write_vector
from mjgranular.law.kernel import Pose
from mjgranular.scheme.forces import Response, linearized, unsoftened


@njit(error_model="numpy")
def pose_of(numbers):
    return Pose(
        read_vector(numbers, 0),
        read_matrix(numbers, 3),
        read_vector(numbers, 12),
        read_vector(numbers, 15),
        read_motion(numbers, 18),
    )


@cache  # compiled once for all tests
class Kernels:
    """Of a law under a surface: samples are arrays of numbers, in the order of the fields."""

    def __init__(self, kernel):
        self.kernel = kernel
        self._size = size_of(kernel.samples)
        element, samples = column(kernel.element, 1), column(kernel.samples, 1)
        read_element, read_sample, write_sample = element.read, samples.read, samples.write
        write_response = column(Response, 1).write
        sample, force_of = kernel.sample, unsoftened(kernel, kernel.respond)
        own, update = kernel.multiplier.own, kernel.multiplier.update
        complexity = kernel.complexity

        @njit(error_model="numpy")
        def take(element, pose, law, surface, g, out):
            found = sample(read_element(element, 0), pose_of(pose), law, surface, g)
            write_sample(out, 0, found)

        @njit(error_model="numpy")
        def force(numbers, law, g, v, out):
            v = read_vector(v, 0)
            write_vector(out, 0, force_of(read_sample(numbers, 0), law, g, v, v, 0.0))

        def response(respond):
            linearize = linearized(kernel, respond)

            @njit(error_model="numpy")
            def call(numbers, law, g, v, p, eps, out):
                v, p = read_vector(v, 0), read_vector(p, 0)
                write_response(out, 0, linearize(read_sample(numbers, 0), law, g, v, p, eps))

            return call

        @njit(error_model="numpy")
        def own_of(numbers, v, eps, out):
            write_vector(out, 0, own(read_sample(numbers, 0), read_vector(v, 0), eps))

        @njit(error_model="numpy")
        def next_of(numbers, v, p, c, eps, out):
            v, p, c = read_vector(v, 0), read_vector(p, 0), read_vector(c, 0)
            write_vector(out, 0, update(read_sample(numbers, 0), v, p, c, eps))

        self._take, self._force = take, force
        self._respond, self._own, self._next = response(kernel.respond), own_of, next_of
        if complexity is not None:
            self._simple = response(kernel.respond_simple)
            self._complexity = njit(
                lambda numbers, law, p, eps: complexity(
                    read_sample(numbers, 0), law, vector(p[0], p[1], p[2]), eps
                )
            )

    def sample(self, element, pose, law, surface, g):
        """Of an element (a row of the table of elements); the pose as 24 numbers."""
        out = np.zeros(self._size)
        numbers = packed(np.array([element]), self.kernel.element)[0]
        self._take(numbers, np.asarray(pose), law, surface, g, out)
        return out

    def force(self, sample, law, g, v):
        out = np.zeros(3)
        self._force(sample, law, g, np.asarray(v), out)
        return out

    def respond(self, sample, law, g, v, p, eps, *, simple=False):
        """Force (3), minus its derivative (9), mismatch."""
        out = np.zeros(13)
        call = self._simple if simple else self._respond
        call(sample, law, g, np.asarray(v), np.asarray(p), eps, out)
        return out

    def complexity(self, sample, law, p, eps):
        return self._complexity(sample, law, np.asarray(p), eps)

    def multiplier(self, sample, v, eps):
        """Of a velocity."""
        out = np.zeros(3)
        self._own(sample, np.asarray(v), eps, out)
        return out

    def next_multiplier(self, sample, v, p, c, eps):
        out = np.zeros(3)
        self._next(sample, np.asarray(v), np.asarray(p), np.asarray(c), eps, out)
        return out
