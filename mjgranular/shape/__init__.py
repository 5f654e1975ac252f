"""Shapes of bodies: elements, made once from the model's geoms."""

from mjgranular.shape.blobs import blobs_from_model as blobs_from_model
from mjgranular.shape.facets import facets_from_model as facets_from_model
from mjgranular.shape.rods import cut_rods as cut_rods
from mjgranular.shape.rods import rods_from_model as rods_from_model
from mjgranular.shape.select import select_geoms as select_geoms
