"""Named tuples that kernels are given by reference: the same fields, and nothing is kept."""

import sys
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from equimesh.fields.compiled import compiled
from equimesh.fields.reference import by_reference


@by_reference
class Bag(NamedTuple):
    number: int
    row: np.ndarray
    share: float
    table: np.ndarray
    bytes: np.ndarray


@compiled
def change(bag, i, j):
    bag.row[i] += bag.table[i, j] * bag.share
    bag.bytes[j] = bag.number


@compiled
def change_twice(bag, i):
    change(bag, i, 0)
    change(bag, i, 1)


@compiled
def sums(bag):
    total = 0.0
    for i in range(bag.row.shape[0]):
        total += bag.row[i]
    return total, bag.bytes[0], bag.table.shape, bag.number


@njit  # this one counts references
def copied(bag):
    return bag.row.copy()


def bag(seed, rows=7):
    rng = np.random.default_rng(seed)
    table = np.ascontiguousarray(rng.random((rows, 3)))
    return Bag(seed, rng.random(rows), 0.25 * seed, table, np.zeros(3, np.uint8))


@pytest.mark.parametrize("seed", [1, 2, 200])
def test_kernels_read_and_write_the_fields(seed):
    given, row = bag(seed), bag(seed).row
    change_twice(given, 4)
    row[4] = row[4] + given.table[4, 0] * given.share + given.table[4, 1] * given.share
    assert np.array_equal(given.row, row)
    assert given.bytes.tolist() == [seed, seed, 0]
    total, byte, shape, number = sums(given)
    assert total == pytest.approx(row.sum(), rel=1e-15)
    assert (byte, shape, number) == (seed, (7, 3), seed)


def test_a_constant_does_not_compile_a_kernel_again():
    given = bag(1)
    change(given, 0, 0)
    change_twice(given, 1)
    assert len(change.signatures) == 1


def test_no_reference_is_kept():
    given = bag(3)
    before = [sys.getrefcount(part) for part in given[1:]]
    for _ in range(10):
        change_twice(given, 2)
        sums(given)
        assert np.array_equal(copied(given), given.row)
    assert [sys.getrefcount(part) for part in given[1:]] == before


def test_other_types_of_fields_are_another_kernel():
    given = bag(2)
    assert sums(given._replace(row=given.row.astype(np.float32)))[0] == pytest.approx(
        given.row.sum(), rel=1e-6
    )
    assert sums(given)[0] == pytest.approx(given.row.sum(), rel=1e-15)
    assert sums(given._replace(row=given.row[::2]))[0] == pytest.approx(
        given.row[::2].sum(), rel=1e-15
    )


def test_what_is_no_field_is_refused():
    with pytest.raises(TypingError):
        sums(bag(1)._replace(row=object()))


def test_threads_have_frames_of_their_own():
    bags = [bag(seed, 5000) for seed in range(1, 9)]

    def work(given):
        for _ in range(50):
            for i in range(0, 5000, 500):
                change(given, i, 1)
        return sums(given)[0]

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(work, bags))
    assert found == [work(bag(seed, 5000)) for seed in range(1, 9)]
