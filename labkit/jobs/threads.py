"""Linear algebra in one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Inputs = ParamSpec("Inputs")
Output = TypeVar("Output")


def one_thread(function: Callable[Inputs, Output]) -> Callable[Inputs, Output]:
    """Limit linear algebra to one thread while a function runs.

    Its matrices are small. Several threads take twice the time for them, and many times that where other programs run, for
    each product waits until all threads had their turn.
    """

    @wraps(function)
    def limited(*args: Inputs.args, **kwargs: Inputs.kwargs) -> Output:
        with threadpool_limits(1):
            return function(*args, **kwargs)

    return limited
