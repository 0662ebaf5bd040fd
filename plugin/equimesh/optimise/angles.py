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
from equimesh.optimise.mesh import FIXED, HELD

__all__ = ["angle_price", "angle_slope", "by_angle"]

_SAME = 1e-9  # of coordinates of about 1 or more: nearer than this is the same corner


@compiled
def _floor_at(shape, sharp, kind, x, y):
    """Sine of the floor at a vertex at (x, y)."""
    least = shape[0]
    count = sharp.shape[0]
    if count == 0 or kind % HELD != FIXED:
        return least
    reach = _SAME * max(1.0, abs(x), abs(y))
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if sharp[middle, 0] < x - reach:
            low = middle + 1
        else:
            high = middle
    while low < count and sharp[low, 0] <= x + reach:
        if abs(sharp[low, 1] - y) <= reach:
            return sharp[low, 2]
        low += 1
    return least


@compiled
def _price(shape, sharp, kind, mx, my, a, b, c):
    """Largest price of the angles of the triangle a, b, c."""
    p, q, r = shape[1], shape[2], shape[3]
    ux, uy = p * (mx[b] - mx[a]) + q * (my[b] - my[a]), r * (my[b] - my[a])
    vx, vy = p * (mx[c] - mx[b]) + q * (my[c] - my[b]), r * (my[c] - my[b])
    wx, wy = -ux - vx, -uy - vy
    cross = abs(ux * vy - uy * vx)
    u, v, w = math.hypot(ux, uy), math.hypot(vx, vy), math.hypot(wx, wy)
    if not cross > 0.0:
        return math.inf
    price = 0.0
    # An obtuse angle's sine says nothing: then one of the others is smaller.
    if ux * wx + uy * wy < 0.0:
        price = _floor_at(shape, sharp, kind[a], mx[a], my[a]) * u * w
    if ux * vx + uy * vy < 0.0:
        price = max(price, _floor_at(shape, sharp, kind[b], mx[b], my[b]) * u * v)
    if vx * wx + vy * wy < 0.0:
        price = max(price, _floor_at(shape, sharp, kind[c], mx[c], my[c]) * v * w)
    return price / cross


@compiled
def angle_price(F, m, a, b, c):
    """Largest price of the angles of the triangle a, b, c, where there is a floor."""
    return _price(F.shape, F.sharp, m.kind, m.x, m.y, a, b, c)


@compiled
def by_angle(F, m, t):
    """Whether the price of t's inside is that of its angles."""
    return F.shape.shape[0] > 0 and angle_price(F, m, m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]) >= abs(
        m.ie[t]
    )


@compiled
def angle_slope(F, m, v, p, q):
    """Derivatives of the price of the triangle v, p, q by v's place."""
    return _slope(F.shape, F.sharp, m.kind, m.x, m.y, v, p, q)


@compiled
def _slope(shape, sharp, kind, mx, my, v, p, q):
    x, y = mx[v], my[v]
    step = 1e-5 * max(abs(mx[p] - x), abs(my[p] - y), abs(mx[q] - x), abs(my[q] - y))
    mx[v] = x + step
    dx = _price(shape, sharp, kind, mx, my, v, p, q)
    mx[v] = x - step
    dx -= _price(shape, sharp, kind, mx, my, v, p, q)
    mx[v] = x
    my[v] = y + step
    dy = _price(shape, sharp, kind, mx, my, v, p, q)
    my[v] = y - step
    dy -= _price(shape, sharp, kind, mx, my, v, p, q)
    my[v] = y
    return 0.5 * dx / step, 0.5 * dy / step
