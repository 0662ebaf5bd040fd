"""A word to those who wait while kernels are compiled for the first time."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

__all__ = ["announced"]

_PATIENCE = 3.0  # seconds of compilation that nobody needs to be told of


class _Watch(event.Listener):  # type: ignore[misc]
    """Adds up the time that compilation takes and says so once, when it is long."""

    def __init__(self) -> None:
        self.begun: list[float] = []  # of those under way: compiling one kernel may ask for others
        self.spent = 0.0
        self.told = False

    def on_start(self, event: Any) -> None:
        now = time.perf_counter()
        spent = self.spent + (now - self.begun[0] if self.begun else 0.0)
        self.begun.append(now)
        if not self.told and spent > _PATIENCE:
            self.told = True
            logging.getLogger("equimesh").warning(
                "equimesh is compiling its kernels: about a minute, once after installation."
            )

    def on_end(self, event: Any) -> None:
        begun = self.begun.pop()
        if not self.begun:
            self.spent += time.perf_counter() - begun


@contextmanager
def announced() -> Iterator[None]:
    """Within it a long compilation is logged as a warning of the logger ``equimesh``.

    Where the program has set up no logging that is a line on standard error. Kernels that come from
    the cache on disk are not compiled.
    """
    with event.install_listener("numba:compile", _Watch()):
        yield
