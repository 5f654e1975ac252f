"""Surfaces: for a point, its depth and the normal of the surface above it."""

from mjgranular.surface.kinds import Bed as Bed
from mjgranular.surface.kinds import HeightField as HeightField
from mjgranular.surface.kinds import Plane as Plane
from mjgranular.surface.surface import Surface as Surface
