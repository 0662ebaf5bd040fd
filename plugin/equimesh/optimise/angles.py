"""A floor for the smallest angle of every triangle, as a price beside the errors'.

The price of an angle a under the floor a0 is ``sin(a0) / sin(a)``: like an error in units of the
tolerance it exceeds 1 where the floor is missed. A triangle's inside is charged the larger of its
error and the price of its smallest angle, so whatever lowers errors keeps angles as well. Angles
are those of the user's coordinates (``KernelField.shape``). At vertices where the sides of the
domain, or constraints, meet at a sharper angle than the floor that angle is the floor
(``KernelField.sharp``).
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled
from equimesh.optimise.mesh import FIXED

__all__ = ["angle_price", "angle_slope", "by_angle"]

_SAME = 1e-9  # of coordinates of about 1 or more: nearer than this is the same corner


@compiled
def _floor_at(F, m, v):
    """Sine of the floor at vertex v."""
    least = F.shape[0]
    count = F.sharp.shape[0]
    if count == 0 or m.kind[v] != FIXED:
        return least
    x, y = m.x[v], m.y[v]
    reach = _SAME * max(1.0, abs(x), abs(y))
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if F.sharp[middle, 0] < x - reach:
            low = middle + 1
        else:
            high = middle
    while low < count and F.sharp[low, 0] <= x + reach:
        if abs(F.sharp[low, 1] - y) <= reach:
            return F.sharp[low, 2]
        low += 1
    return least


@compiled
def angle_price(F, m, a, b, c):
    """Largest price of the angles of the triangle a, b, c; 0 where there is no floor."""
    if F.shape.shape[0] == 0:
        return 0.0
    p, q, r = F.shape[1], F.shape[2], F.shape[3]
    ux, uy = p * (m.x[b] - m.x[a]) + q * (m.y[b] - m.y[a]), r * (m.y[b] - m.y[a])
    vx, vy = p * (m.x[c] - m.x[b]) + q * (m.y[c] - m.y[b]), r * (m.y[c] - m.y[b])
    wx, wy = -ux - vx, -uy - vy
    cross = abs(ux * vy - uy * vx)
    u, v, w = math.hypot(ux, uy), math.hypot(vx, vy), math.hypot(wx, wy)
    if not cross > 0.0:
        return math.inf
    price = 0.0
    # An obtuse angle's sine says nothing: then one of the others is smaller.
    if ux * wx + uy * wy < 0.0:
        price = _floor_at(F, m, a) * u * w
    if ux * vx + uy * vy < 0.0:
        price = max(price, _floor_at(F, m, b) * u * v)
    if vx * wx + vy * wy < 0.0:
        price = max(price, _floor_at(F, m, c) * v * w)
    return price / cross


@compiled
def by_angle(F, m, t):
    """Whether the price of t's inside is that of its angles."""
    if F.shape.shape[0] == 0:
        return False
    return angle_price(F, m, m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]) >= abs(m.ie[t])


@compiled
def angle_slope(F, m, v, p, q):
    """Derivatives of the price of the triangle v, p, q by v's place."""
    x, y = m.x[v], m.y[v]
    step = 1e-5 * max(abs(m.x[p] - x), abs(m.y[p] - y), abs(m.x[q] - x), abs(m.y[q] - y))
    m.x[v] = x + step
    dx = angle_price(F, m, v, p, q)
    m.x[v] = x - step
    dx -= angle_price(F, m, v, p, q)
    m.x[v] = x
    m.y[v] = y + step
    dy = angle_price(F, m, v, p, q)
    m.y[v] = y - step
    dy -= angle_price(F, m, v, p, q)
    m.y[v] = y
    return 0.5 * dx / step, 0.5 * dy / step
