"""Figures with what was asked for and a verdict."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Record", "Row", "table"]


@dataclass(frozen=True)
class Row:
    """One line of the acceptance table; ``passed`` is None where it could not be measured."""

    what: str
    figure: str
    asked: str
    passed: bool | None

    @property
    def verdict(self) -> str:
        return {True: "yes", False: "**no**", None: "skipped"}[self.passed]


@dataclass
class Record:
    """What the sections have in common.

    ``ratios`` are certified bounds over the largest errors that were found independently, ``cases``
    the lines of the table of functions.
    """

    ratios: dict[str, float] = field(default_factory=dict)
    cases: list[tuple[str, ...]] = field(default_factory=list)

    def bound(self, name: str, bound: float, found: float) -> None:
        self.ratios[name] = bound / found

    def tightness(self) -> Row:
        """Never below the error, up to the measurement's own rounding, and at most 5 % above."""
        low, high = min(self.ratios.values()), max(self.ratios.values())
        return Row(
            f"certified bound over the independent measurement, {len(self.ratios)} meshes",
            f"{_near_one(low)} to {high:.4f}",
            "1 to 1.05",
            low >= 1.0 - 1e-12 and high <= 1.05,
        )


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """In Markdown."""
    rows = [head, ("---",) * len(head), *lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _near_one(value: float) -> str:
    return f"1 {'+' if value >= 1.0 else '-'} {abs(value - 1.0):.1g}"
