"""Media: densities, grain sizes and, law by law, published constants with sources."""

from mjgranular.medium.file import get_medium as get_medium
from mjgranular.medium.file import media as media
from mjgranular.medium.file import read_medium as read_medium
from mjgranular.medium.file import register_medium as register_medium
from mjgranular.medium.medium import Medium as Medium
from mjgranular.medium.medium import Quantity as Quantity
