"""The paper's four examples and the figures that it prints for them."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CASES", "SQUARE", "Case", "Printed"]

SQUARE = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Printed:
    """A row of Tables 1 to 4: errors of the triangles, their number and the label in print."""

    smallest: float
    median: float
    tenth: float  # the 90th percentile
    largest: float
    triangles: int
    label: str


@dataclass(frozen=True)
class Case:
    """An example: the function, the equation ``k1 f_xx + k2 f_yy = 0`` it solves, and its rows.

    ``rows`` has two of optimal shape, one equilateral and one by PLTMG, in the order that counts
    and medians prove (see the page); ``label`` keeps what is printed.
    """

    number: int
    formula: str
    text: str
    k: tuple[float, float]
    rows: tuple[Printed, Printed, Printed, Printed]


CASES = (
    Case(
        1,
        "exp(5 x) sin(5 y)",
        "exp(5*x)*sin(5*y)",
        (1.0, 1.0),
        (
            Printed(0.1360, 0.1379, 0.1394, 0.1416, 1098, "optimal shape"),
            Printed(0.05273, 0.05390, 0.05498, 0.05740, 2933, "equilateral"),
            Printed(0.01945, 0.06644, 0.06793, 0.1488, 3190, "PLTMG"),
            Printed(0.01912, 0.07600, 0.1410, 0.2177, 3080, "PLTMG"),
        ),
    ),
    Case(
        2,
        "Re 1 / (z - z0)^2, z0 = 1/2 - i/5",
        "((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2",
        (1.0, 1.0),
        (
            Printed(0.04442, 0.04680, 0.04853, 0.05310, 436, "optimal shape"),
            Printed(0.01876, 0.02009, 0.02155, 0.02566, 1072, "equilateral"),
            Printed(0.00747, 0.02181, 0.02320, 0.04616, 1376, "PLTMG"),
            Printed(0.00848, 0.02890, 0.05213, 0.08426, 1168, "PLTMG"),
        ),
    ),
    Case(
        3,
        "Re 1 / (z - z0)^4",
        "(((x-1/2)**2+(y+1/5)**2)**2-8*(x-1/2)**2*(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**4",
        (1.0, 1.0),
        # Printed a hundred times smaller.
        (
            Printed(2.146, 2.366, 2.597, 3.379, 300, "optimal shape"),
            Printed(1.021, 1.160, 1.322, 1.696, 650, "equilateral"),
            Printed(0.837, 1.567, 1.886, 3.725, 661, "equilateral"),
            Printed(0.145, 1.690, 3.055, 5.184, 720, "PLTMG"),
        ),
    ),
    Case(
        4,
        "Example 2 at (x, sqrt(5) y)",
        "((x-1/2)**2-(sqrt(5)*y+1/5)**2)/((x-1/2)**2+(sqrt(5)*y+1/5)**2)**2",
        (5.0, 1.0),
        (
            Printed(0.1015, 0.1246, 0.1461, 0.1810, 162, "optimal shape"),
            Printed(0.02433, 0.03169, 0.04059, 0.06004, 711, "optimal shape"),
            Printed(0.01990, 0.04237, 0.05665, 0.1135, 701, "equilateral"),
            Printed(0.00368, 0.05914, 0.1844, 0.4723, 796, "PLTMG"),
        ),
    ),
)
