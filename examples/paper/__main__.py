"""Reproduce Tables 1 to 4 and the figures: ``python examples/paper OUTDIR``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from cases import CASES, Case, Printed
from pictures import draw_example, draw_triangles
from strategies import Row, run

__all__ = ["main"]

_HEAD = """\
| strategy | asked for | smallest | median | 90 % | largest | triangles | C | N\\*/N |
|---|---|---|---|---|---|---|---|---|
"""


def main(folder: Path) -> None:
    """Write README.md with the tables, and the pictures, to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_triangles(folder / "triangles.png")
    parts = []
    for case in CASES:
        rows = run(case)
        names = draw_example(case, rows, folder)
        parts.append(_section(case, rows, names))
        print(f"Example {case.number} is done.", flush=True)
    page = (Path(__file__).parent / "page.md").read_text(encoding="utf-8")
    (folder / "README.md").write_text(page.replace("@TABLES@", "\n".join(parts)), encoding="utf-8")


def _section(case: Case, rows: list[Row], names: list[str]) -> str:
    lines = [f"## Table {case.number}: Example {case.number}, {case.formula}\n\n", _HEAD]
    notes = []
    for row in rows:
        if row.printed is not None:
            lines.append(_printed(row.strategy, row.printed))
        lines.append(_measured(row))
        if row.note:
            notes.append(f"- {row.strategy}, {row.errors.size} triangles: {row.note}.\n")
    pictures = "".join(f"\n![{name[:-4]}]({name})\n" for name in names)
    return "".join([*lines, "\n", *notes, pictures])


def _printed(strategy: str, p: Printed) -> str:
    label = "" if strategy.startswith(p.label) else f', there "{p.label}"'
    numbers = " | ".join(f"{v:.4g}" for v in (p.smallest, p.median, p.tenth, p.largest))
    return f"| *{strategy}, paper{label}* | | {numbers} | {p.triangles} | | |\n"


def _measured(row: Row) -> str:
    e = row.errors
    numbers = " | ".join(f"{v:.4g}" for v in (e.min(), np.median(e), np.quantile(e, 0.9), e.max()))
    aim = "" if np.isnan(row.aim) else f"{row.aim:.4g}"
    return (
        f"| **{row.strategy}** | {aim} | {numbers} | {e.size} | {row.constant:.3f} "
        f"| {row.efficiency:.3f} |\n"
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python examples/paper OUTDIR")
    main(Path(sys.argv[1]))
