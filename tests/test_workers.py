"""Ranges cover what they are to cover once, whatever the number of threads, and errors come out."""

import threading

import numpy as np
import pytest

from equimesh.fields.workers import in_ranges


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 10, 1000, 12_345])
def test_ranges_cover_everything_once(monkeypatch, threads, count):
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", threads)
    seen = np.zeros(count, int)

    def work(start, end):
        assert start < end
        seen[start:end] += 1

    in_ranges(work, count, 10)
    assert (seen == 1).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_what_goes_wrong_in_a_range_is_raised(monkeypatch, threads):
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", threads)

    def work(start, end):
        raise ValueError(start)

    with pytest.raises(ValueError, match=r"^[05]$"):
        in_ranges(work, 10, 5)
    in_ranges(lambda start, end: None, 10, 5)  # the helpers are still there


def test_several_callers_share_the_helpers(monkeypatch):
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", 2)
    sums = np.zeros(4, int)

    def called(number):
        parts = np.zeros(100, int)

        def work(start, end):
            parts[start:end] = np.arange(start, end)

        for _ in range(50):
            in_ranges(work, 100, 7)
        sums[number] = parts.sum()

    callers = [threading.Thread(target=called, args=(number,)) for number in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert (sums == 4950).all()
