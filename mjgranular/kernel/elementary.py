"""Exponential and logarithm in plain arithmetic, which vectorizes.

Those of the math library take one number at a time, and a loop over facets spends most of its time
in them. These are within a few units in the last place, and the same on every processor.
"""

from functools import partial
from typing import Any

from numba import types

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.intrinsics import intrinsic

# ln 2 in two parts, the first with trailing zeros: times a small integer it is exact.
_LN2, _LN2_REST = 0.693147180369123816490, 1.90821492927058770002e-10
_LOG2_E = 1.44269504088896340736
_ROUND = 6755399441055744.0  # 1.5 * 2^52: a sum with it has no fraction
_EXPONENT_BITS, _ONE_BITS = 0x4330000000000000, 0x3FF0000000000000  # of 2^52 and of 1
_MANTISSA = 0x000FFFFFFFFFFFFF
_LEAST, _MOST = -700.0, 700.0


def _same_bits(result: Any, argument: Any) -> Any:
    """Make a kernel that returns the value of one type with the 64 bits of one of another."""

    @intrinsic
    def cast(typingctx: Any, value: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.bitcast(args[0], context.get_value_type(result))

        return result(argument), codegen

    return cast


bits_of = _same_bits(types.int64, types.float64)
number_of = _same_bits(types.float64, types.int64)


@partial(compiled, inline=True)
def exponential(x):
    """Return exp(x), for x clipped to -700 to 700.

    2^n exp(r) with x = n ln 2 + r; of exp(r), |r| <= 0.35, the first 14 terms of the Taylor series.
    """
    x = min(max(x, _LEAST), _MOST)
    rounded = x * _LOG2_E + _ROUND
    n = rounded - _ROUND
    r = (x - n * _LN2) - n * _LN2_REST
    # In pairs and pairs of pairs, which shortens the chain of dependent operations.
    r2 = r * r
    r4 = r2 * r2
    a = (1.0 + r) + r2 * (0.5 + r * (1.0 / 6.0))
    b = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5040.0))
    c = (1.0 / 40320.0 + r * (1.0 / 362880.0)) + r2 * (1.0 / 3628800.0 + r * (1.0 / 39916800.0))
    e = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0)
    s = (a + r4 * b) + (r4 * r4) * (c + r4 * e)
    # The lowest bits of `rounded` are those of n; shifted, an exponent.
    return s * number_of((bits_of(rounded) << 52) + _ONE_BITS)


@partial(compiled, inline=True)
def logarithm(x):
    """Return ln(x), for normal x > 0.

    n ln 2 + 2 artanh(z), x = 2^n m, z = (m - 1) / (m + 1), |z| <= 0.18, by 11 terms of its series.
    """
    bits = bits_of(x)
    n = number_of((bits >> 52) | _EXPONENT_BITS) - (4503599627370496.0 + 1023.0)
    m = number_of((bits & _MANTISSA) | _ONE_BITS)
    if m > 1.4142135623730951:
        m *= 0.5
        n += 1.0
    z = (m - 1.0) / (m + 1.0)
    y = z * z
    y2 = y * y
    y4 = y2 * y2
    a = (1.0 / 3.0 + y * (1.0 / 5.0)) + y2 * (1.0 / 7.0 + y * (1.0 / 9.0))
    b = (1.0 / 11.0 + y * (1.0 / 13.0)) + y2 * (1.0 / 15.0 + y * (1.0 / 17.0))
    s = (a + y4 * b) + (y4 * y4) * (1.0 / 19.0 + y * (1.0 / 21.0))
    return n * _LN2 + (n * _LN2_REST + 2.0 * z * (s * y + 1.0))
