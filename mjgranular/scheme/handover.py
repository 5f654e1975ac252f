"""What the implicit scheme leaves behind when a step is solved: wrenches, contacts, a start."""

from __future__ import annotations

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.elementary import bits_of
from mjgranular.kernel.engine import solve_inertia
from mjgranular.kernel.memory import CONTACTS, ELEMENT_COUNT, floats, ints
from mjgranular.kernel.records import contact_records
from mjgranular.scheme import desk as d
from mjgranular.scheme.constraints import rows_of
from mjgranular.scheme.layout import FORCE, INDEX, head_records


@compiled
def hand_over(desk, room, bodies, share):
    """The bodies' wrenches about their own centres of mass."""
    nbody = desk[d.NBODY]
    own = floats(room.own, 6 * nbody)
    wet = floats(room.wet, nbody)
    trees = floats(desk[d.TREE_COM], 3 * nbody)
    coms = floats(desk[d.COM], 3 * nbody)
    for slot in range(len(bodies)):
        body = bodies[slot]
        if wet[body.body] == 0.0:
            continue
        w = own[6 * body.body : 6 * body.body + 6]
        x = coms[3 * body.body] - trees[3 * body.root]
        y = coms[3 * body.body + 1] - trees[3 * body.root + 1]
        z = coms[3 * body.body + 2] - trees[3 * body.root + 2]
        body.wrench[0] = share * w[3]
        body.wrench[1] = share * w[4]
        body.wrench[2] = share * w[5]
        body.wrench[3] = share * (w[0] - (y * w[5] - z * w[4]))
        body.wrench[4] = share * (w[1] - (z * w[3] - x * w[5]))
        body.wrench[5] = share * (w[2] - (x * w[4] - y * w[3]))


@compiled
def warm_engine(desk, room, h):
    """Has the engine's constraint solver begin at the acceleration that has been foreseen.

    By itself it stops when it is within some 1e-6 of it, which is little where things move, but at
    rest a kick, beside what the sand holds. From here it has nothing to do but to see that it is
    there. It solves for the acceleration in front of the integrator's own damping C, which is
    (1 + M^-1 C) (v' - v) / h.
    """
    nv = desk[d.NV]
    rows = rows_of(desk[d.ROWS], 1)[0]
    if ints(desk[d.DATA] + rows.count, 1)[0] == 0:
        return
    velocity = floats(room.velocity, nv)
    start = floats(room.start, nv)
    rate = floats(room.rate, nv)
    warmstart = floats(desk[d.WARMSTART], nv)
    for j in range(nv):
        rate[j] = (velocity[j] - start[j]) / h
    if desk[d.INTEGRATOR] == d.PLAIN:
        for j in range(nv):
            warmstart[j] = rate[j]
        return
    extra = floats(room.extra, nv * nv)
    damped = floats(room.product, nv)
    for i in range(nv):
        total = 0.0
        for j in range(nv):
            total += extra[i * nv + j] * rate[j]
        damped[i] = total
    solve_inertia(desk[d.MODEL], desk[d.DATA], room.answer, room.product, 1)
    answer = floats(room.answer, nv)
    for j in range(nv):
        warmstart[j] = rate[j] + answer[j]


@compiled
def tell_contacts(table, desk, count, share):
    """Writes the forces on elements to their contacts."""
    contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
    heads = head_records(desk[d.HEADS], count)
    lanes, size = desk[d.LANES], desk[d.BLOCK_SIZE]
    for i in range(count):
        block = floats(desk[d.BLOCKS] + 8 * size * i, size)
        for lane in range(heads[i].live):
            contact = contacts[bits_of(block[INDEX * lanes + lane])]
            for k in range(3):
                contact.force[k] = share * block[(FORCE + k) * lanes + lane]
