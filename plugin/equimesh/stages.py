"""Progress and time of the stages of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from equimesh.compiling import announced
from equimesh.errors import Cancelled

__all__ = ["Report", "Stages", "between"]

Report = Callable[[float], None]  # hears how far a part of a run is, from 0 to 1


def between(report: Report, low: float, high: float) -> Report:
    """What hears how far a part is that goes from ``low`` to ``high``."""
    return lambda fraction: report(low + (high - low) * fraction)


@dataclass
class Stages:
    """Tells progress and keeps the time of each stage."""

    progress: Callable[[str, float], Any] | None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[Report]:
        """Time what is done inside; gives a function that reports a fraction.

        Raises Cancelled where the caller's ``progress`` returns False.
        """
        start = time.perf_counter()

        def report(fraction: float) -> None:
            if self.progress is not None and self.progress(name, fraction) is False:
                raise Cancelled("Cancelled by the caller.")

        report(0.0)
        with announced():
            yield report
        report(1.0)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
