"""A rail stopped by another thread than the one that moves it."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from labkit.devices.protocols import Rail
from labkit.drivers.simulated.controllers.pty_port import Controller
from labkit.errors import RailError

from .conftest import WAIT_S


def error_of_a_move_stopped(rail: Rail, to_mm: float, moving: threading.Event) -> str:
    """What a move raises that is stopped once the carriage is moving."""
    with ThreadPoolExecutor(1) as pool:
        move = pool.submit(rail.move_to, to_mm)
        assert moving.wait(WAIT_S)
        rail.stop()
        with pytest.raises(RailError) as caught:
            move.result(WAIT_S)
    return str(caught.value)


def error_of_a_move_stopped_before_it_began(
    rail: Rail, to_mm: float, controller: Controller, command: str
) -> str:
    """What a move raises that is stopped while the driver still checks, by this command, whether it may move."""
    stopper = threading.Thread(target=rail.stop)

    def stop(heard: str) -> None:
        if heard == command and not stopper.ident:
            stopper.start()

    controller.noticed = stop
    with pytest.raises(RailError) as caught:
        rail.move_to(to_mm)
    stopper.join(WAIT_S)
    return str(caught.value)
