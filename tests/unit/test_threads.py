"""Public functions with much linear algebra run it in one thread."""

from __future__ import annotations

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import labkit
from labkit.jobs.threads import one_thread


def of_linear_algebra() -> set[int]:
    """Numbers of threads of the libraries for linear algebra that are loaded."""
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.mark.parametrize("fails", [False, True])
def test_linear_algebra_has_one_thread_while_a_function_runs_and_as_many_as_before_after(
    fails: bool,
) -> None:
    inside = set[int]()

    @one_thread
    def work(power: int, *, of: float) -> float:
        inside.update(of_linear_algebra())
        if fails:
            raise ValueError("no power")
        return float(of**power)

    with threadpool_limits(2):
        if fails:
            with pytest.raises(ValueError, match="no power"):
                work(2, of=3.0)
        else:
            assert work(2, of=3.0) == 9.0
        assert of_linear_algebra() == {2}
    assert inside == {1}


@pytest.mark.parametrize(
    "name",
    [
        *("advise", "fit", "fit_image", "measure_chart", "measure_edges", "reprocess"),
        *("restore", "run_study", "summarise_field", "write_report"),
    ],
)
def test_public_functions_have_one_thread(name: str) -> None:
    assert getattr(labkit, name).__wrapped__.__name__ == name
