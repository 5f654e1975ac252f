"""Sand with memory: tracks and rims that bodies have made, as heights over a surface."""

from mjgranular.relief.memory import Heights as Heights
from mjgranular.relief.memory import Memory as Memory
