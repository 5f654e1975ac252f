"""Surfaces: for a point, its depth and the normal of the surface above it."""

from mjgranular.surface.surface import Bed as Bed
from mjgranular.surface.surface import HeightField as HeightField
from mjgranular.surface.surface import Plane as Plane
from mjgranular.surface.surface import Surface as Surface
from mjgranular.surface.surface import surface_of as surface_of
from mjgranular.surface.surface import surfaces as surfaces
