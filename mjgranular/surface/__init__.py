"""Surfaces: for a point, its depth and the normal of the surface above it."""

from mjgranular.surface.bed import Bed as Bed
from mjgranular.surface.height_field import HeightField as HeightField
from mjgranular.surface.plane import Plane as Plane
from mjgranular.surface.surface import Surface as Surface
