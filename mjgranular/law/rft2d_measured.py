"""Two-dimensional resistive force theory with the measured stresses, without a fit."""

import math
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any, ClassVar, Self

import numpy as np

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.vector import vector
from mjgranular.law.law import register_law
from mjgranular.law.rft import RftLaw
from mjgranular.law.rft2d import PER_CUBIC_CENTIMETRE, Rft2dLaw, check_plates, split_slope
from mjgranular.medium import Medium, get_medium
from mjgranular.medium.stresses import ATTACKS, measured_stresses

# Rows of tilt, 30 degrees apart from 0 to 180; columns of attack, from -45 to 315 degrees, evenly
# spaced in the coordinate of `around`; alpha_z and alpha_x, each with its slopes.
_COLUMNS, _NUMBERS = 2 * (ATTACKS - 1) + 1, 6
_TAN_30 = math.tan(math.radians(30))
_STEEP = 1e-6  # least horizontal part of a motion to divide by; chosen


@partial(compiled, inline=True)
def around(c, s):
    """Return the coordinate of a direction, and its derivative by the angle.

    It is the tangent of the angle near the first axis, 2 minus the cotangent near the second, and
    so on around: -1 at -45 degrees, 0, 2, 4 and 6 along the axes. It has a continuous derivative.
    """
    if abs(s) <= abs(c):
        place = s / c + (0.0 if c > 0.0 else 4.0)
    else:
        place = (2.0 if s > 0.0 else 6.0) - c / s
    return place, 1.0 / max(c * c, s * s)


@partial(compiled, inline=True)
def at_corner(table, at, h, k, h_x, k_x, i, j, i_y, j_y):
    """Return a corner's contribution to an interpolated number, and its derivatives by x and y.

    The number at the corner has the index `at`; its slopes by x and by y follow it. Weights of the
    number and of its slope are h and k along x, i and j along y, with derivatives h_x, k_x, i_y,
    j_y.
    """
    f, f_x, f_y = table[at], table[at + 1], table[at + 2]
    along, turned = f * h + f_x * k, f * h_x + f_x * k_x
    return vector(along * i + f_y * h * j, turned * i + f_y * h_x * j, along * i_y + f_y * h * j_y)


@partial(compiled, inline=True)
def table_response(law, sin_b, cos_b, sin_g, cos_g):
    """Return the measured response, interpolated by cubics: see `planar_response`."""
    x, x_b = around(cos_b, sin_b)
    y, y_g = around(cos_g, sin_g)
    # The tilt's cell: its tangents are 0, tan 30, 2 - tan 30 and 2 in each quarter.
    quarter = 3 if x >= 2.0 else 0
    x = min(max(x - (2.0 if x >= 2.0 else 0.0), 0.0), 2.0)
    low = 0.0 if x < _TAN_30 else (_TAN_30 if x < 2.0 - _TAN_30 else 2.0 - _TAN_30)
    cell = 0 if x < _TAN_30 else (1 if x < 2.0 - _TAN_30 else 2)
    width = 2.0 - 2.0 * _TAN_30 if cell == 1 else _TAN_30
    x = (x - low) / width
    y = 3.0 * y + 3.0
    column = min(max(int(y), 0), _COLUMNS - 2)
    y = y - float(column)
    first = _NUMBERS * (_COLUMNS * (quarter + cell) + column)
    second = first + _NUMBERS * _COLUMNS

    p, q = 1.0 - x, 1.0 - y
    a, a_x, b, b_x = (1.0 + 2.0 * x) * p * p, -6.0 * x * p, x * x * (3.0 - 2.0 * x), 6.0 * x * p
    u, u_x, v, v_x = (
        width * x * p * p,
        width * p * (1.0 - 3.0 * x),
        -width * x * x * p,
        width * x * (3.0 * x - 2.0),
    )
    c, c_y, d, d_y = (1.0 + 2.0 * y) * q * q, -6.0 * y * q, y * y * (3.0 - 2.0 * y), 6.0 * y * q
    r, r_y, s, s_y = y * q * q, q * (1.0 - 3.0 * y), -y * y * q, y * (3.0 * y - 2.0)
    z = at_corner(law.table, first, a, u, a_x, u_x, c, r, c_y, r_y)
    z = z + at_corner(law.table, first + 6, a, u, a_x, u_x, d, s, d_y, s_y)
    z = z + at_corner(law.table, second, b, v, b_x, v_x, c, r, c_y, r_y)
    z = z + at_corner(law.table, second + 6, b, v, b_x, v_x, d, s, d_y, s_y)
    e = at_corner(law.table, first + 3, a, u, a_x, u_x, c, r, c_y, r_y)
    e = e + at_corner(law.table, first + 9, a, u, a_x, u_x, d, s, d_y, s_y)
    e = e + at_corner(law.table, second + 3, b, v, b_x, v_x, c, r, c_y, r_y)
    e = e + at_corner(law.table, second + 9, b, v, b_x, v_x, d, s, d_y, s_y)
    x_b, y_g = x_b / width, 3.0 * y_g
    up, up_g, up_b, back, back_g, back_b = z.x, z.z * y_g, z.y * x_b, e.x, e.z * y_g, e.y * x_b
    # Sand dissipates energy; the interpolation may add some, which is removed.
    given = -(back * cos_g + up * sin_g)
    if given > 0.0:
        given_g = back * sin_g - up * cos_g - (back_g * cos_g + up_g * sin_g)
        given_b = -(back_b * cos_g + up_b * sin_g)
        up, back = up + given * sin_g, back + given * cos_g
        up_g, up_b = up_g + given_g * sin_g + given * cos_g, up_b + given_b * sin_g
        back_g, back_b = back_g + given_g * cos_g - given * sin_g, back_b + given_b * cos_g
    return up, up_g, up_b, back, back_g, back_b


@partial(compiled, inline=True)
def table_level(law, rise, down):
    """Return the measured response of level elements: see `level_response`."""
    cos_g = math.sqrt(max(1.0 - rise * rise, _STEEP * _STEEP))
    up, up_g, _, back, back_g, _ = table_response(
        law, 0.0, -1.0 if down > 0.0 else 1.0, -rise, cos_g
    )
    inverse = 1.0 / cos_g  # its derivative by the attack, over v.z, is -rise
    flat = back * inverse
    flat_r = (flat * rise * inverse - back_g * inverse) * inverse
    return flat, flat_r, 0.0, up, -up_g * inverse, 0.0


@cache
def interpolation_table(name: str) -> np.ndarray:
    """Return the numbers that `table_response` reads, from the measured stresses of a medium.

    A plate turned by 180 degrees is the same plate, and its response is mirror-symmetric. Values
    that are equal by symmetry are averaged if they were measured twice.
    """
    measured = measured_stresses()[name].copy()
    rows = np.array([3, 4, 5, 6, 1, 2, 3])  # of tilts 0, 30, ..., 180; 90 is -90
    mirror = np.array([1.0, -1.0])[:, None, None]  # of alpha_z and alpha_x
    measured[:, [0, -1]] = measured[:, [0, -1]].mean(axis=1, keepdims=True)
    ends = measured[:, :, [0, -1]]
    measured[:, :, [0, -1]] = (ends + mirror * ends[:, ::-1]) / 2
    half, other = measured[:, rows], mirror * measured[:, ::-1][:, rows, ::-1]
    # Attacks from -90 to 90, then to 270 degrees; the table begins at -45.
    circle = np.concatenate([half[:, :, 3:], other[:, :, 1:], half[:, :, 1:4]], axis=2)
    quarter = np.array([0.0, _TAN_30, 2.0 - _TAN_30])
    tilts = np.concatenate([quarter, 2.0 + quarter, [4.0]])
    by_tilt = _slopes(np.moveaxis(circle, 1, 0), np.diff(tilts))
    by_attack = _slopes(np.moveaxis(circle, 2, 0), np.ones(_COLUMNS - 1))
    slopes = np.moveaxis(by_tilt, 0, 1), np.moveaxis(by_attack, 0, 2)
    return np.moveaxis(np.stack([circle, *slopes]), (0, 1), (3, 2)).reshape(-1)


def _slopes(values: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return slopes of periodic rows that do not overshoot: F. N. Fritsch, J. Butland 1984."""
    shape = (-1, *[1] * (values.ndim - 1))
    after, steps = np.diff(values, axis=0) / steps.reshape(shape), steps.reshape(shape)
    before, last = np.roll(after, 1, axis=0), np.roll(steps, 1, axis=0)
    rises = before * after > 0
    first, second = 2 * steps + last, steps + 2 * last
    parts = first / np.where(rises, before, 1.0) + second / np.where(rises, after, 1.0)
    slopes = np.where(rises, (first + second) / parts, 0.0)
    return np.concatenate([slopes, slopes[:1]])


@register_law
@dataclass(frozen=True)
class MeasuredRft2dLaw(RftLaw):
    """`Rft2dLaw` with the stresses that Li et al. measured instead of their Fourier series.

    Between the 91 measured tilts and attacks of a plate each stress is interpolated by cubics that
    do not overshoot.

    Attributes:
        table: name of the medium of the stresses.
        density: bulk density, for inertia of sand [kg/m^3].
        scale: factor on the stresses.
        inertia, added, cone, rise: as for `Rft2dLaw`.

    Raises:
        UnknownNameError: that medium has no measured stresses.
        InputError: a value that is not finite, or negative.
    """

    name: ClassVar[str] = "rft2d_measured"
    title: ClassVar[str] = "resistive force theory of 2D plates by measured stresses"
    citation: ClassVar[str] = Rft2dLaw.citation
    slope: ClassVar[Any] = split_slope(table_response, table_level)
    strength_keys: ClassVar[tuple[str, ...]] = Rft2dLaw.strength_keys
    density_keys: ClassVar[tuple[str, ...]] = Rft2dLaw.density_keys

    table: str
    density: float = 0.0
    scale: float = 1.0
    inertia: float = 0.0
    rise: bool = False
    added: float = 0.0
    cone: float = 0.0

    def __post_init__(self) -> None:
        check_plates(self)
        known = measured_stresses()
        if not isinstance(self.table, str) or self.table not in known:
            raise UnknownNameError("measured stresses of", self.table, sorted(known))

    @classmethod
    def from_medium(cls, medium: Medium | str) -> Self:
        medium = get_medium(medium)
        constants: dict[str, Any] = medium.constants_for(cls.name)
        for key in constants.keys() - {field.name for field in fields(cls)}:
            raise InputError(
                f"medium {medium.name!r}: the law {cls.name!r} has no constant {key!r}"
            )
        return cls(medium.name.split()[0], **{"density": medium.density.value, **constants})

    def parameters(self, medium: Medium) -> np.ndarray:
        table = interpolation_table(self.table)
        # A plate dragged along itself: alpha_x at tilt 0, attack 0.
        side = table[_NUMBERS * 3 + 3]
        return self.record(table=table, side=side, scale=self.scale * PER_CUBIC_CENTIMETRE)
