"""Schemes: time integration of the sand's forces."""

from mjgranular.scheme.choice import Auto as Auto
from mjgranular.scheme.choice import get_scheme as get_scheme
from mjgranular.scheme.choice import schemes as schemes
from mjgranular.scheme.explicit import Explicit as Explicit
from mjgranular.scheme.implicit import Implicit as Implicit
from mjgranular.scheme.scheme import Scheme as Scheme
