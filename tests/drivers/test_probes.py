"""Asking at a serial port which rail is there, on simulated controllers: what answers is named, and nothing moves."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from labkit.drivers.grbl import probe as grbl_probe
from labkit.drivers.grbl.probe import answers as grbl_answers
from labkit.drivers.simulated.controllers.grbl import grbl_port
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.pty_port import PtyPort
from labkit.drivers.simulated.controllers.zaber import ZaberController
from labkit.drivers.zaber.probe import answers as zaber_answers
from labkit.errors import RailError


def zaber_port() -> PtyPort:
    return PtyPort(ZaberController(100_000, speed=50_000, carriage=20_000))


@pytest.mark.parametrize(
    ("make", "answers", "name"),
    [
        (grbl_port, grbl_answers, "GRBL"),
        (zaber_port, zaber_answers, "Zaber"),
        (zaber_port, grbl_answers, None),
        (grbl_port, zaber_answers, None),
    ],
)
def test_each_probe_knows_its_own_controller_and_no_other(
    make: Callable[[], PtyPort],
    answers: Callable[[str], str | None],
    name: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grbl_probe, "BOOT_S", 1.0)
    port = make()
    try:
        controller = port.controller
        assert isinstance(controller, GrblController | ZaberController)
        moved: list[float] = []
        controller.moved = moved.append
        found = answers(port.path)
        assert found is None if name is None else str(found).startswith(name)
        assert moved == []
    finally:
        port.close()


def test_a_port_at_which_nothing_answers_is_given_up_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grbl_probe, "BOOT_S", 0.2)
    near, far = os.openpty()
    try:
        assert grbl_answers(os.ttyname(far)) is None
    finally:
        os.close(near)
        os.close(far)


def test_a_port_that_is_not_there_is_an_error() -> None:
    with pytest.raises(RailError, match="there is no serial port"):
        zaber_answers("/dev/ttyUSB987")
