"""Work here and in processes."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from math import factorial
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NoReturn

import pytest

from labkit.errors import FitError, LostTasksError, WorkersError
from labkit.jobs.execute import (
    NO_MEMORY,
    Executed,
    Workers,
    in_order,
    map_in_order,
    run_all,
)
from labkit.jobs.processes import say
from labkit.numerics import versions

HOURS = """
import time
from labkit.jobs.execute import run_all
if __name__ == "__main__":
    results = run_all(time.sleep, [0, 3600, 3600], 2)
    next(results)
    print("under way", flush=True)
    next(results)
"""

PLAIN = """
from math import factorial
from labkit.jobs.execute import run_all
print(sorted(run_all(factorial, [5, 6, 7], 2)), __name__, __file__)
"""


def kill_the_first_time(task: tuple[Path, int]) -> int:
    """The process at work is killed, unless this was tried before."""
    tried, number = task
    if not tried.exists():
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def kill_at(number: int) -> int:
    """Every process that works on number 2 is killed."""
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def lack_memory_at(number: int) -> int:
    """Number 2 needs too much."""
    if number == 2:
        raise MemoryError("954 MB")
    return number


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_comes_back_with_its_index(workers: int) -> None:
    assert sorted(run_all(factorial, [5, 6, 7], workers)) == [(0, 120), (1, 720), (2, 5040)]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_exception_of_a_task_is_raised(workers: int) -> None:
    with pytest.raises(ValueError, match="factorial"):
        list(run_all(factorial, [5, -1, 7], workers))


def test_one_worker_goes_in_order() -> None:
    assert [index for index, _ in run_all(factorial, [3, 1, 2], 1)] == [0, 1, 2]


def test_results_that_come_early_wait_for_their_turn() -> None:
    came = iter([(2, "c"), (0, "a"), (1, "b"), (3, "d")])
    ordered = in_order(came)
    assert next(ordered) == (0, "a")
    assert next(came) == (1, "b")  # the first is not held back by those after it
    assert list(in_order([(2, "c"), (0, "a"), (1, "b")])) == [(0, "a"), (1, "b"), (2, "c")]


def test_a_run_maps_as_the_builtin_does() -> None:
    with Workers(2) as run:
        assert list(map_in_order(run, factorial, [5, 3, 4])) == [120, 6, 24]


def test_less_than_one_worker_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        list(run_all(factorial, [1], 0))


def test_an_exception_ends_tasks_that_would_go_on_for_an_hour() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        list(run_all(time.sleep, [-1, 3600, 3600, 3600], 2))
    assert active_children() == []


@pytest.mark.parametrize("delay_s", [0.02, 1.0])
def test_an_interrupt_ends_all_workers_and_leaves_no_files(
    delay_s: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    # at once: while the workers are being started; later: while they work
    threading.Timer(delay_s, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        list(run_all(time.sleep, [3600] * 4, 2))
    assert active_children() == []
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_who_asks_for_no_more_ends_the_rest() -> None:
    results = run_all(time.sleep, [0, 3600, 3600], 2)
    assert next(results) == (0, None)
    results.close()  # type: ignore[attr-defined]
    assert active_children() == []


def test_large_tasks_and_results_travel() -> None:
    assert sorted(run_all(bytes.upper, [b"a" * 3_000_000, b"b" * 3_000_000], 2)) == [
        (0, b"A" * 3_000_000),
        (1, b"B" * 3_000_000),
    ]


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL]
)
def test_workers_end_with_their_parent_however_it_dies_and_leave_no_files(
    number: signal.Signals, tmp_path: Path
) -> None:
    script, files = tmp_path / "hours.py", tmp_path / "files"
    script.write_text(HOURS)
    files.mkdir()
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(files)},
    ) as parent:
        assert parent.stdout is not None
        parent.stdout.readline()
        parent.send_signal(number)
        parent.communicate(
            timeout=5
        )  # until every process that holds its streams open has ended: workers do so in 0.1 s
    assert parent.returncode == -number
    assert list(files.iterdir()) == []


def test_tasks_under_way_when_a_worker_is_killed_are_tried_again(tmp_path: Path) -> None:
    tasks = [(tmp_path / "tried", 0), *((tmp_path, k) for k in range(1, 6))]
    assert sorted(run_all(kill_the_first_time, tasks, 2)) == [(k, k) for k in range(6)]


def test_a_task_that_kills_every_worker_is_named_and_all_others_are_done() -> None:
    results = run_all(kill_at, range(6), 2)
    assert sorted(next(results)[0] for _ in range(5)) == [0, 1, 3, 4, 5]
    with pytest.raises(
        LostTasksError, match="1 of the tasks did not come to an end: the process at work"
    ) as caught:
        next(results)
    assert [task for task, _ in caught.value.lost] == [2]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_task_that_lacks_memory_is_named_and_all_others_are_done(workers: int) -> None:
    results = run_all(lack_memory_at, [1, 2, 3], workers)
    assert sorted([next(results), next(results)]) == [(0, 1), (2, 3)]
    with pytest.raises(LostTasksError) as caught:
        next(results)
    assert caught.value.lost == ((2, NO_MEMORY),)


def fail_at(number: int) -> int:
    """Number 2 cannot be fitted."""
    if number == 2:
        raise FitError("no optimum")
    return number


@pytest.mark.parametrize("workers", [1, 2])
def test_a_fit_that_fails_is_named_and_all_others_are_done(workers: int) -> None:
    results = run_all(fail_at, [1, 2, 3], workers)
    assert sorted([next(results), next(results)]) == [(0, 1), (2, 3)]
    with pytest.raises(LostTasksError) as caught:
        next(results)
    assert caught.value.lost == ((2, "no optimum"),)


def test_a_killed_process_costs_its_task_alone(tmp_path: Path) -> None:
    """The other process works on: each task that it began is done once."""
    tasks = [(tmp_path / "tried", tmp_path), *((tmp_path, tmp_path) for _ in range(5))]
    assert len([*run_all(count_and_kill_first, tasks, 2)]) == 6
    assert len(list(tmp_path.glob("begun-*"))) == 7


def count_and_kill_first(task: tuple[Path, Path]) -> None:
    """The process at work is killed the first time; each beginning is counted."""
    tempfile.mkstemp(prefix="begun-", dir=task[1])
    time.sleep(0.05)
    kill_the_first_time((task[0], 0))


def test_any_executor_runs_tasks_in_chunks() -> None:
    with ThreadPoolExecutor(2) as executor:
        run = Executed(executor, 2)
        assert sorted(run(factorial, range(100))) == [(k, factorial(k)) for k in range(100)]
        with pytest.raises(LostTasksError) as caught:
            list(run(fail_at, [1, 2, 3]))
        assert caught.value.lost == ((2, "no optimum"),)


def test_an_executor_that_is_broken_is_named() -> None:
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor,
        pytest.raises(WorkersError, match=r"takes no more tasks: .*terminated abruptly"),
    ):
        list(Executed(executor, 1)(kill_at, [1, 2, 3]))


class Closed(ThreadPoolExecutor):
    """Takes no tasks, as the client of a cluster that was lost a moment ago."""

    def submit(self, *_: object, **__: object) -> NoReturn:
        raise ValueError("Client is closed")


def test_what_is_lost_is_named_where_an_executor_takes_no_task() -> None:
    def watch() -> None:
        raise WorkersError("the scheduler is gone")

    with Closed(1) as executor:
        with pytest.raises(WorkersError, match=r"^the scheduler is gone$"):
            list(Executed(executor, 1, watch)(factorial, [1]))
        with pytest.raises(ValueError, match=r"^Client is closed$"):
            list(Executed(executor, 1)(factorial, [1]))


def test_a_worker_of_other_versions_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = {**versions(), "NumPy": "1.0"}
    monkeypatch.setattr("labkit.jobs.execute.versions", lambda: sent)
    with ThreadPoolExecutor(1) as executor, pytest.raises(WorkersError) as caught:
        list(Executed(executor, 1)(factorial, [1]))
    assert re.fullmatch(
        r"worker \d+ on \S+ has NumPy [\d.]+, not 1\.0: install the same versions there as here",
        str(caught.value),
    )


def say_and_wait(heard: Path) -> str:
    """Says a word, and ends once it was heard."""
    say(heard.name)
    while not heard.exists():
        time.sleep(0.01)
    return heard.name


@pytest.mark.parametrize("workers", [1, 2])
def test_what_tasks_say_is_heard_while_they_work(workers: int, tmp_path: Path) -> None:
    with Workers(workers, lambda step: (tmp_path / step).touch()) as run:
        assert sorted(run(say_and_wait, [tmp_path / "start 1", tmp_path / "start 2"])) == [
            (0, "start 1"),
            (1, "start 2"),
        ]


def test_workers_go_on_with_the_next_tasks_after_one_was_lost() -> None:
    with Workers(2) as run:
        with pytest.raises(LostTasksError):
            list(run(kill_at, [1, 2, 3]))
        assert sorted(run(kill_at, [3, 4])) == [(0, 3), (1, 4)]


def warmed_up(run: Workers) -> set[BaseProcess]:
    """The processes of this one, once two have begun in addition."""
    wanted = len(active_children()) + 2
    run.warm_up("math")
    while len(active_children()) < wanted:
        time.sleep(0.01)
    return set(active_children())


def test_processes_begin_before_there_is_work_for_them() -> None:
    before = set(active_children())
    with Workers(2) as run:
        begun = warmed_up(run) - before
        assert len(begun) == 2
        assert sorted(run(factorial, [5, 6, 7])) == [(0, 120), (1, 720), (2, 5040)]
        assert set(active_children()) - before == begun
    assert set(active_children()) == before


def test_processes_that_are_killed_before_there_is_work_are_begun_anew() -> None:
    before = set(active_children())
    with Workers(2) as run:
        begun = warmed_up(run) - before
        for process in begun:
            process.kill()
            process.join()
        assert sorted(run(factorial, [5, 6])) == [(0, 120), (1, 720)]


def test_a_script_needs_no_guard_of_its_main_part(tmp_path: Path) -> None:
    script = tmp_path / "plain.py"
    script.write_text(PLAIN, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout == f"[(0, 120), (1, 720), (2, 5040)] __main__ {script}\n"


def test_one_worker_needs_no_warming_up() -> None:
    before = set(active_children())
    with Workers(1) as run:
        run.warm_up("math")
        assert set(active_children()) == before


HUNG_UP = "import signal; signal.signal(signal.SIGHUP, signal.default_int_handler)\n"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_processes_end_in_silence(number: signal.Signals, tmp_path: Path) -> None:
    """Ends a whole process group, as a closed terminal does; of the killed one nobody else is told."""
    script = tmp_path / "hours.py"
    script.write_text(HUNG_UP + HOURS)
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"under way\n"
        end = os.kill if number == signal.SIGKILL else os.killpg
        end(running.pid, number)
        _, said = running.communicate(timeout=100)
    ours = [b"KeyboardInterrupt"] if number == signal.SIGHUP else []
    assert said.splitlines()[-1:] == ours
    assert b"resource_tracker" not in said
    assert b"leaked" not in said
