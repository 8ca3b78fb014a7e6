"""Work here and in processes."""

from math import factorial

import pytest

from labkit.execute import run_all


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_comes_back_with_its_index(workers: int) -> None:
    assert sorted(run_all(factorial, [5, 6, 7], workers)) == [(0, 120), (1, 720), (2, 5040)]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_exception_of_a_task_is_raised(workers: int) -> None:
    with pytest.raises(ValueError, match="factorial"):
        list(run_all(factorial, [5, -1, 7], workers))


def test_one_worker_goes_in_order() -> None:
    assert [index for index, _ in run_all(factorial, [3, 1, 2], 1)] == [0, 1, 2]


def test_less_than_one_worker_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        list(run_all(factorial, [1], 0))
