"""Sand that remembers: what bodies have pressed down and heaped up, as heights over a surface."""

from mjgranular.relief.heights import Heights as Heights
from mjgranular.relief.memory import Memory as Memory
