"""Compiled work on ranges of triangles, shared by threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba

__all__ = ["in_ranges"]

_MOST = 64  # ranges


def in_ranges(work: Callable[[int, int], None], count: int, length: int = 2048) -> None:
    """Call ``work(start, end)`` on ranges that cover 0..count.

    The ranges have ``length``, or more where they would be many: each costs some 30 microseconds.
    They are fixed and must not depend on each other, so that the answer is the same whatever the
    number of threads (numba's: ``NUMBA_NUM_THREADS``). ``work`` should release the GIL.
    """
    length = max(length, -(-count // _MOST))
    ranges = [(start, min(start + length, count)) for start in range(0, count, length)]
    threads = min(numba.config.NUMBA_NUM_THREADS, len(ranges))
    if threads <= 1:
        for start, end in ranges:
            work(start, end)
        return
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(work, start, end) for start, end in ranges]:
            done.result()
