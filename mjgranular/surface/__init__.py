"""Where the sand is: for a point, its depth and the normal of the surface above it."""

from mjgranular.surface.plane import Plane as Plane
from mjgranular.surface.surface import Surface as Surface
