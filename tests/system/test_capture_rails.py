"""Captures on serial rails in trouble: every fault at every step, on the real drivers, a real pty, simulated controllers.

Whatever happens, each frame in the session was taken with the carriage truly where the plan wants it, and the capture
either gets over the trouble by itself or ends with one line, after which it can be resumed. The steps are of the talk
between driver and controller; all faults of a step run side by side, since they mostly wait.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from labkit.drivers.simulated.controllers.pty_port import LineFault

from .rails_in_trouble import (
    FAULTS,
    RAILS,
    Bench,
    Photographs,
    Setup,
    left_over,
    run,
    side_by_side,
)

pytestmark = pytest.mark.timeout(600)  # of a machine that does much else

Step = tuple[str, int, float]
"""A command of the driver, its number, and the time after it in s."""

GRBL_STEPS: dict[str, Step] = {
    "asking who it is": (r"\$I", 1, 0.0),
    "asking its settings": (r"\$\$", 1, 0.0),
    "beginning to home": (r"\$H", 1, 0.0),
    "homing": (r"\$H", 1, 0.02),
    "setting the modes": (r"G21.*", 1, 0.0),
    "beginning the run-up": (r"G53.*", 1, 0.0),
    "in the run-up": (r"G53.*", 1, 0.05),
    "in the last millimetre": (r"G53.*", 1, 0.11),
    "the dwell": (r"G4.*", 1, 0.0),
    "the end of a move": (r"\$G", 3, 0.0),
    "where it stands": (r"\?", 5, 0.0),
    "the second stop": (r"G53.*", 3, 0.0),
    "moving to the second stop": (r"G53.*", 3, 0.04),
    "moving to the third stop": (r"G53.*", 5, 0.06),
    "the end of the last move": (r"\$G", 5, 0.0),
}

ZABER_STEPS: dict[str, Step] = {
    "asking its limits": (r"get limit.*", 1, 0.0),
    "beginning to home": (r"home", 1, 0.0),
    "homing": (r"home", 1, 0.02),
    "beginning the run-up": (r"move.*", 1, 0.0),
    "in the run-up": (r"move.*", 1, 0.04),
    "the last millimetre": (r"move.*", 2, 0.0),
    "where it stands": (r"get pos", 3, 0.0),
    "asking whether it moves": (r"", 4, 0.0),
    "moving to the second stop": (r"move.*", 3, 0.02),
    "moving to the third stop": (r"move.*", 5, 0.03),
}

CASES = [
    *(("grbl", step) for step in GRBL_STEPS),
    *(
        ("grblhal", step)
        for step in (
            "asking its settings",
            "homing",
            "in the run-up",
            "the dwell",
            "where it stands",
        )
    ),
    *(("zaber", step) for step in ZABER_STEPS),
]

OPENING = ("asking who it is", "asking its settings", "asking its limits")
"""Steps before the capture begins, where nothing is tried again."""


def problems(
    setup: Setup,
    step: str,
    at: Step,
    name: str,
    photographs: Photographs,
    folder: Path,
    check: bool = False,
) -> list[str]:
    """What goes wrong in a capture with one fault: empty if all is as it should be."""
    kind, lasts_s = FAULTS[name]
    command, nth, after_s = at
    port = setup.port([LineFault(kind, command, nth, after_s=after_s, lasts_s=lasts_s)])
    found = []
    bench = Bench(photographs, setup, port)
    try:
        ended = run(setup, bench, folder, check=check)
        for_good = name == "unplugged for good"
        if for_good != (ended is not None) and step not in OPENING:
            found.append(f"{name}: {ended or 'no error, though the rail is gone'}")
        if not port.struck:
            found.append(f"{name}: the step never came")
        if ended and "\n" in ended:
            found.append(f"{name}: more than one line")
    finally:
        port.close()
    return found + [
        f"{name}: {problem}" for problem in left_over(setup, bench, folder, ended)
    ]


@pytest.mark.parametrize(("kind", "step"), CASES)
def test_every_fault_at_every_step_is_got_over_or_told(
    kind: str, step: str, photographs: Photographs, tmp_path: Path
) -> None:
    at = (ZABER_STEPS if kind == "zaber" else GRBL_STEPS)[step]
    assert (
        side_by_side(
            lambda name, folder: problems(RAILS[kind], step, at, name, photographs, folder),
            tmp_path,
        )
        == []
    )


@pytest.mark.parametrize(
    ("kind", "step", "at"),
    [
        ("grbl", "homing", (r"\$H", 1, 0.02)),
        ("grbl", "moving to the near end", (r"G53.*", 1, 0.05)),
        ("grbl", "where it stands there", (r"\$G", 3, 0.0)),
        ("grbl", "moving to the far end", (r"G53.*", 3, 0.04)),
        ("zaber", "homing", ("home", 1, 0.02)),
        ("zaber", "moving to the near end", ("move.*", 1, 0.04)),
        ("zaber", "moving to the far end", ("move.*", 3, 0.02)),
    ],
)
def test_every_fault_of_the_look_round_is_got_over_or_told(
    kind: str, step: str, at: Step, photographs: Photographs, tmp_path: Path
) -> None:
    assert (
        side_by_side(
            lambda name, folder: problems(
                RAILS[kind], step, at, name, photographs, folder, True
            ),
            tmp_path,
        )
        == []
    )


COMMANDS = {
    "grbl": [r"\$I", r"\$\$", r"\$H", r"G21.*", r"G53.*", r"G4.*", r"\$G", r"\?", "\x18"],
    "zaber": ["get.*", "home", "move.*", "", "warnings.*", "stop"],
}


def several(seed: int) -> tuple[Setup, list[LineFault]]:
    """A rail, and two to four faults anywhere."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(RAILS)))
    commands, kinds = (
        COMMANDS["zaber" if name == "zaber" else "grbl"],
        sorted({kind for kind, _ in FAULTS.values()}),
    )
    faults = [
        LineFault(
            kinds[rng.integers(len(kinds))],
            commands[rng.integers(len(commands))],
            nth=int(rng.integers(1, 9)),
            times=int(rng.integers(1, 3)),
            after_s=float(rng.choice([0.0, rng.uniform(0, 0.3)])),
            lasts_s=float(rng.uniform(0, 1.2)),
        )
        for _ in range(rng.integers(2, 5))
    ]
    return RAILS[name], faults


@pytest.mark.parametrize("first", range(0, 48, 12))
def test_several_faults_in_one_capture_lose_no_frame_and_spoil_none(
    first: int, photographs: Photographs, tmp_path: Path
) -> None:
    def one(seed: int) -> list[str]:
        setup, faults = several(seed)
        port = setup.port(faults)
        bench = Bench(photographs, setup, port)
        ended = run(setup, bench, tmp_path / str(seed))
        port.close()
        return [
            f"{seed}: {problem}"
            for problem in left_over(setup, bench, tmp_path / str(seed), ended)
        ]

    with ThreadPoolExecutor(12) as pool:
        assert [
            problem
            for found in pool.map(one, range(first, first + 12))
            for problem in found
        ] == []
