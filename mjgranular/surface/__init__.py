"""Surfaces: for a point, its depth and the normal of the surface above it."""

from mjgranular.surface.choice import surfaces as surfaces
from mjgranular.surface.surface import Bed as Bed
from mjgranular.surface.surface import HeightField as HeightField
from mjgranular.surface.surface import Plane as Plane
from mjgranular.surface.surface import Surface as Surface
