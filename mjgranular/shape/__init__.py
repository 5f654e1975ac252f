"""Shapes of bodies: elements, made once from the model's geoms."""

from mjgranular.shape.facets import facets_from_model as facets_from_model
from mjgranular.shape.select import select_geoms as select_geoms
from mjgranular.shape.single import blobs_from_model as blobs_from_model
from mjgranular.shape.single import cut_rods as cut_rods
from mjgranular.shape.single import rods_from_model as rods_from_model
