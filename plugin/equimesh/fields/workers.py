"""Compiled work on ranges of triangles, shared by threads."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["apart", "in_ranges"]

_MOST = 64  # ranges
_BETWEEN = 16  # numbers: two lines of memory


def apart(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """A copy (n,) that shares no line of memory with other arrays.

    A thread that writes a few numbers all the time would make others wait that read or write what
    is beside them.
    """
    whole = np.zeros(len(numbers) + 2 * _BETWEEN, np.int64)
    whole[_BETWEEN:-_BETWEEN] = numbers
    return whole[_BETWEEN:-_BETWEEN]


@functools.cache
def _helpers(process: int, number: int) -> ThreadPoolExecutor:
    """Threads beside the caller's, which wait for work: to start them would take longer than a
    small mesh does. A forked process needs its own."""
    return ThreadPoolExecutor(number, "equimesh")


def in_ranges(work: Callable[[int, int], None], count: int, length: int = 2048) -> None:
    """Call ``work(start, end)`` on ranges that cover 0..count.

    The ranges have ``length``, or more where they would be many: each costs some 30 microseconds.
    They are fixed and must not depend on each other, so that the answer is the same whatever the
    number of threads (numba's: ``NUMBA_NUM_THREADS``). ``work`` should release the GIL.
    """
    if count <= length:
        if count > 0:
            work(0, count)
        return
    length = max(length, -(-count // _MOST))
    ranges = [(start, min(start + length, count)) for start in range(0, count, length)]
    threads = min(numba.config.NUMBA_NUM_THREADS, len(ranges))

    def share() -> None:
        while ranges:
            try:
                start, end = ranges.pop()
            except IndexError:  # another thread was faster
                return
            work(start, end)

    if threads > 1:
        helpers = _helpers(os.getpid(), numba.config.NUMBA_NUM_THREADS - 1)
        shares = [helpers.submit(share) for _ in range(threads - 1)]
        try:
            share()
        finally:
            for other in shares:
                if not other.cancel():
                    other.result()
    else:
        share()
