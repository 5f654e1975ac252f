"""The ground of every kernel: compiling, MuJoCo's memory, the motion of a body.

Nothing here knows a law. `compiled` turns a function into machine code that is kept on disk,
`memory` reads arrays of a running simulation by their address, `motion` gives a body's velocity.
"""

from mjgranular.kernel.compiled import compiled as compiled
from mjgranular.kernel.compiled import entry as entry
