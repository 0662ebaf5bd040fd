"""Changing the connectivity of a mesh, and undoing it."""

from __future__ import annotations

from equimesh.fields.compiled import compiled, outlined
from equimesh.optimise.mesh import (
    FREE_TRIANGLES,
    FREE_VERTICES,
    GONE,
    LOG_T,
    LOG_V,
    LOST_T,
    LOST_V,
    RECORDING,
    TRIANGLES,
    VERTICES,
)

__all__ = [
    "ample",
    "begin", "commit", "drop_triangle", "drop_vertex", "flip", "flippable", "new_triangle",
    "new_vertex", "note_triangle", "note_vertex", "positive", "redirect", "rollback", "room_left",
    "stamp_touched", "star", "turns_by",
]  # fmt: skip

# Twice the area of a triangle over the squares of its edges. A split may make the thinnest
# triangles that stay positive when coordinates are rounded; other changes keep a distance from
# that, so that every triangle they leave can be split.
_THINNEST = 1e-12
_AMPLE = 1e-9


@compiled
def turns_by(ax, ay, bx, by, cx, cy, share):
    """Whether twice the area of a, b, c exceeds this share of the squares of two edges."""
    ux, uy, vx, vy = bx - ax, by - ay, cx - ax, cy - ay
    return ux * vy - uy * vx > share * (ux * ux + uy * uy + vx * vx + vy * vy)


@compiled
def positive(ax, ay, bx, by, cx, cy):
    """Whether a, b, c turn left beyond doubt."""
    return turns_by(ax, ay, bx, by, cx, cy, _THINNEST)


@compiled
def ample(ax, ay, bx, by, cx, cy):
    """Whether a, b, c turn left and could be split."""
    return turns_by(ax, ay, bx, by, cx, cy, _AMPLE)


@compiled
def note_triangle(m, t):
    """Write triangle t to the journal before it is changed."""
    if m.count[RECORDING] == 0:
        return
    k = m.count[LOG_T]
    m.count[LOG_T] = k + 1
    row, errors = m.log_ti[k], m.log_tf[k]
    row[0] = t
    for i in range(3):
        row[1 + i] = m.tv[t, i]
        row[4 + i] = m.tn[t, i]
        row[7 + i] = m.wall[t, i]
        errors[i] = m.ee[t, i]
        errors[3 + i] = m.ep[t, i]
    errors[6], errors[7], errors[8] = m.ie[t], m.ix[t], m.iy[t]


@compiled
def note_vertex(m, v):
    """Write vertex v to the journal before it is changed."""
    if m.count[RECORDING] == 0:
        return
    k = m.count[LOG_V]
    m.count[LOG_V] = k + 1
    m.log_vi[k, 0], m.log_vi[k, 1], m.log_vi[k, 2] = v, m.kind[v], m.side[v]
    m.log_vi[k, 3] = m.v2t[v]
    row = m.log_vf[k]
    row[0], row[1], row[2] = m.x[v], m.y[v], m.z[v]
    row[3] = m.w[v]
    for i in range(5):
        row[4 + i] = m.jet[v, i]


@compiled
def begin(m):
    """Start recording."""
    m.count[RECORDING] = 1
    m.count[LOG_T] = m.count[LOG_V] = m.count[LOST_T] = m.count[LOST_V] = 0


@compiled
def room_left(m):
    """Whether the journal and the spare slots have room for another change of a star."""
    c = m.count
    return (
        c[LOG_T] + 600 < m.log_ti.shape[0]
        and c[LOG_V] + 600 < m.log_vi.shape[0]
        and c[TRIANGLES] - c[FREE_TRIANGLES] + 16 < m.tv.shape[0]
        and c[VERTICES] - c[FREE_VERTICES] + 8 < m.x.shape[0]
    )


@compiled
def commit(m):
    """Keep what was done since ``begin``."""
    c = m.count
    c[RECORDING] = 0
    for i in range(c[LOST_T]):
        m.spare_t[c[FREE_TRIANGLES]] = m.lost_t[i]
        c[FREE_TRIANGLES] += 1
    for i in range(c[LOST_V]):
        m.spare_v[c[FREE_VERTICES]] = m.lost_v[i]
        c[FREE_VERTICES] += 1


@compiled
def stamp_touched(m, stamp, number):
    """Give the corners of the live triangles in the journal the ``stamp`` (v,) ``number``."""
    for i in range(m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.tv[t, 0] >= 0:
            for k in range(3):
                stamp[m.tv[t, k]] = number


@outlined
def rollback(m):
    """Undo everything since ``begin``."""
    c = m.count
    for k in range(c[LOG_T] - 1, -1, -1):
        row, errors = m.log_ti[k], m.log_tf[k]
        t = row[0]
        if m.tv[t, 0] >= 0 and row[1] < 0:  # was a spare slot: back onto the stack
            m.spare_t[c[FREE_TRIANGLES]] = t
            c[FREE_TRIANGLES] += 1
        for i in range(3):
            m.tv[t, i] = row[1 + i]
            m.tn[t, i] = row[4 + i]
            m.wall[t, i] = row[7 + i]
            m.ee[t, i] = errors[i]
            m.ep[t, i] = errors[3 + i]
        m.ie[t], m.ix[t], m.iy[t] = errors[6], errors[7], errors[8]
    for k in range(c[LOG_V] - 1, -1, -1):
        v = m.log_vi[k, 0]
        if m.kind[v] != GONE and m.log_vi[k, 1] == GONE:
            m.spare_v[c[FREE_VERTICES]] = v
            c[FREE_VERTICES] += 1
        m.kind[v], m.side[v], m.v2t[v] = m.log_vi[k, 1], m.log_vi[k, 2], m.log_vi[k, 3]
        row = m.log_vf[k]
        m.x[v], m.y[v], m.z[v] = row[0], row[1], row[2]
        m.w[v] = row[3]
        for i in range(5):
            m.jet[v, i] = row[4 + i]
    c[RECORDING] = 0


@compiled
def new_triangle(m):
    """A spare slot."""
    c = m.count
    if c[FREE_TRIANGLES] > 0:
        c[FREE_TRIANGLES] -= 1
        t = m.spare_t[c[FREE_TRIANGLES]]
    else:
        t = c[TRIANGLES]
        c[TRIANGLES] += 1
    note_triangle(m, t)
    m.tv[t, 0] = 0  # taken
    return t


@compiled
def drop_triangle(m, t):
    note_triangle(m, t)
    m.tv[t, 0] = -1
    c = m.count
    if c[RECORDING] == 1:
        m.lost_t[c[LOST_T]] = t
        c[LOST_T] += 1
    else:
        m.spare_t[c[FREE_TRIANGLES]] = t
        c[FREE_TRIANGLES] += 1


@compiled
def new_vertex(m, x, y, z, kind, side):
    c = m.count
    if c[FREE_VERTICES] > 0:
        c[FREE_VERTICES] -= 1
        v = m.spare_v[c[FREE_VERTICES]]
    else:
        v = c[VERTICES]
        c[VERTICES] += 1
    note_vertex(m, v)
    m.x[v], m.y[v], m.z[v], m.kind[v], m.side[v] = x, y, z, kind, side
    return v


@compiled
def drop_vertex(m, v):
    note_vertex(m, v)
    m.kind[v] = GONE
    c = m.count
    if c[RECORDING] == 1:
        m.lost_v[c[LOST_V]] = v
        c[LOST_V] += 1
    else:
        m.spare_v[c[FREE_VERTICES]] = v
        c[FREE_VERTICES] += 1


@outlined
def star(m, v):
    """Triangles around v counter-clockwise, into ``m.ring``; ``(number, closed)``.

    ``ring[1, i]`` is the triangle, ``ring[2, i]`` the index of v in it, ``ring[0, i]`` the vertex
    after v in it; an open star has one more vertex than triangles. A number of 0: too many.
    """
    first = m.v2t[v]
    t = first
    limit = m.ring.shape[1] - 2
    for _ in range(limit):  # clockwise to the border, or once around
        i = 0 if m.tv[t, 0] == v else (1 if m.tv[t, 1] == v else 2)
        before = m.tn[t, i]
        if before < 0:
            break
        t = before
        if t == first:
            break
    start = t
    n = 0
    while n < limit:
        i = 0 if m.tv[t, 0] == v else (1 if m.tv[t, 1] == v else 2)
        m.ring[0, n] = m.tv[t, (i + 1) % 3]
        m.ring[1, n] = t
        m.ring[2, n] = i
        n += 1
        following = m.tn[t, (i + 2) % 3]
        if following < 0:
            m.ring[0, n] = m.tv[t, (i + 2) % 3]
            return n, False
        if following == start:
            return n, True
        t = following
    return 0, False


@compiled
def redirect(m, u, old, new, a):
    """Make u, beyond the edge that starts at a on the other side, look at ``new``."""
    if u >= 0:
        note_triangle(m, u)
        for j in range(3):
            if m.tn[u, j] == old and m.tv[u, (j + 1) % 3] == a:
                m.tn[u, j] = new
                return


@compiled
def point_back(m, t, old, new):
    """Make the neighbour ``t`` (or the border) look at ``new`` where it looked at ``old``."""
    if t >= 0:
        note_triangle(m, t)
        for i in range(3):
            if m.tn[t, i] == old:
                m.tn[t, i] = new
                return


@compiled
def flippable(m, t, k):
    """(u, a, b, c, d): edge k of t from a to b, across it c in t and d in the neighbour u.

    u is -1 where the edge must stay or the other diagonal would make a triangle that is no good.
    """
    u, a, b, c = m.tn[t, k], m.tv[t, k], m.tv[t, (k + 1) % 3], m.tv[t, (k + 2) % 3]
    if u < 0 or m.wall[t, k] == 1:
        return -1, a, b, c, c
    j = 0
    while not (m.tn[u, j] == t and m.tv[u, j] == b):  # two triangles may share two edges at a tip
        j += 1
    d = m.tv[u, (j + 2) % 3]
    if not (
        ample(m.x[c], m.y[c], m.x[a], m.y[a], m.x[d], m.y[d])
        and ample(m.x[d], m.y[d], m.x[b], m.y[b], m.x[c], m.y[c])
    ):
        u = -1
    return u, a, b, c, d


@outlined
def flip(m, t, k):
    """Replace edge k of t by the other diagonal; errors of the five edges move along.

    Afterwards t = (c, a, d) and the neighbour u = (d, b, c), with the new edge last in both; its
    errors and those of the two insides are the caller's to set. Returns u.
    """
    u = m.tn[t, k]
    j = 0 if m.tn[u, 0] == t else (1 if m.tn[u, 1] == t else 2)
    if m.tv[u, j] != m.tv[t, (k + 1) % 3]:  # two triangles may share two edges at a tip
        j = (j + 1) % 3
        while m.tv[u, j] != m.tv[t, (k + 1) % 3]:
            j = (j + 1) % 3
    note_triangle(m, t)
    note_triangle(m, u)
    k1, k2, j1, j2 = (k + 1) % 3, (k + 2) % 3, (j + 1) % 3, (j + 2) % 3
    a, b, c, d = m.tv[t, k], m.tv[t, k1], m.tv[t, k2], m.tv[u, j2]
    ca, bc, ad, db = m.tn[t, k2], m.tn[t, k1], m.tn[u, j1], m.tn[u, j2]
    wca, wbc, wad, wdb = m.wall[t, k2], m.wall[t, k1], m.wall[u, j1], m.wall[u, j2]
    eca, ebc, ead, edb = m.ee[t, k2], m.ee[t, k1], m.ee[u, j1], m.ee[u, j2]
    pca, pbc, pad, pdb = m.ep[t, k2], m.ep[t, k1], m.ep[u, j1], m.ep[u, j2]
    m.tv[t, 0], m.tv[t, 1], m.tv[t, 2] = c, a, d
    m.tn[t, 0], m.tn[t, 1], m.tn[t, 2] = ca, ad, u
    m.wall[t, 0], m.wall[t, 1], m.wall[t, 2] = wca, wad, 0
    m.ee[t, 0], m.ee[t, 1] = eca, ead
    m.ep[t, 0], m.ep[t, 1] = pca, pad
    m.tv[u, 0], m.tv[u, 1], m.tv[u, 2] = d, b, c
    m.tn[u, 0], m.tn[u, 1], m.tn[u, 2] = db, bc, t
    m.wall[u, 0], m.wall[u, 1], m.wall[u, 2] = wdb, wbc, 0
    m.ee[u, 0], m.ee[u, 1] = edb, ebc
    m.ep[u, 0], m.ep[u, 1] = pdb, pbc
    point_back(m, ad, u, t)
    point_back(m, bc, t, u)
    note_vertex(m, a)
    note_vertex(m, b)
    m.v2t[a], m.v2t[b] = t, u
    return u
