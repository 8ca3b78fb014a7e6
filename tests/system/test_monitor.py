"""`labkit capture --monitor` as a user runs it: without a terminal, the page alone leads a rail that a person sets."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from labkit.session.session import Session
from tests.drivers.test_web_monitor import PLAN

pytestmark = pytest.mark.timeout(
    600
)  # of a machine that does much else: whole captures in processes of their own

LABKIT = [sys.executable, "-c", "from labkit.cli import main; main()"]


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "plan.toml"
    by_hand = PLAN.replace(
        '[rail]\naddress = "simulated:seed=7"', '[rail]\naddress = "manual:"'
    )
    path.write_text(by_hand.replace('"web:"', '"simulated:seed=7"'))
    return path


def command(plan: Path, *flags: str) -> list[str]:
    return [*LABKIT, "capture", str(plan), str(plan.parent / "s"), "--no-preflight", *flags]


def page(line: str) -> ClientConnection:
    """The connection of the operator's page of an address that was printed."""
    (url,) = re.findall(r"http://\S+", line)
    return connect(
        f"ws{url[4:]}/socket",
        origin=Origin(f"http://{urlsplit(url).netloc}"),
        open_timeout=100,
    )


def questions(wire: ClientConnection) -> Iterator[dict[str, str]]:
    """Each question once, until the capture has ended."""
    answered = 0
    while True:
        state = json.loads(wire.recv(timeout=100))
        if state["phase"] in ("complete", "stopped", "interrupted"):
            return
        question = state["question"]
        if question is not None and question["number"] > answered:
            answered = question["number"]
            yield question


def test_a_capture_without_terminal_is_led_from_the_page(plan: Path) -> None:
    listen = ["--listen", "127.0.0.1:0"]
    with subprocess.Popen(
        command(plan, "--monitor", *listen),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stderr is not None
        try:
            line = running.stderr.readline()
            assert line.startswith("The operator's page: http://127.0.0.1:")
            with page(line) as wire:
                asked = []
                for question in questions(wire):
                    asked.append(question["text"].partition(",")[0])
                    position = re.findall(r"to ([\d.]+) mm", question["text"])[0]
                    wire.send(json.dumps({"answer": question["number"], "text": position}))
            assert asked == ["Set the rail to 50.000 mm", "Set the rail to 100.500 mm"]
            assert running.wait(timeout=300) == 0
        finally:
            running.kill()
    assert len(Session.open(plan.parent / "s").frames) == 9


def test_ctrl_c_ends_a_question_and_says_how_to_go_on(plan: Path) -> None:
    with subprocess.Popen(
        command(plan, "--listen", "127.0.0.1:0"),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stderr is not None
        try:
            with page(running.stderr.readline()) as wire:
                next(questions(wire))
                running.send_signal(signal.SIGINT)
                assert list(questions(wire)) == []
            assert running.wait(timeout=300) == 130
            assert "--resume --no-preflight --listen 127.0.0.1:0" in running.stderr.read()
        finally:
            running.kill()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], "someone is needed here"),
        (["--monitor", "--listen", "127.0.0.1:99999"], "allowed is web://HOST:PORT"),
        (["--listen", "host/a/b"], "allowed is web://HOST:PORT"),
        (
            ["--listen", "192.0.2.1:8642"],
            "cannot listen on 192.0.2.1 port 8642: Cannot assign requested address; this machine",
        ),
    ],
)
def test_without_anyone_to_ask_or_anywhere_to_listen_it_is_one_line(
    flags: list[str], words: str, plan: Path
) -> None:
    ended = subprocess.run(
        command(plan, *flags),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode in (1, 2)
    (line,) = ended.stderr.splitlines()
    assert words in line


def test_at_a_terminal_what_is_typed_is_not_painted_over(plan: Path) -> None:
    near, far = os.openpty()
    with subprocess.Popen(
        command(plan),
        stdin=far,
        stderr=far,
        stdout=far,
        env={**os.environ, "TERM": "xterm"},
    ) as running:
        os.close(far)
        try:
            seen = b""
            for position in (b"50.000", b"100.500"):
                while b"type what its scale says in mm:" not in seen:
                    seen += os.read(near, 4096)
                os.write(near, position)
                seen = b""
                while select.select([near], [], [], 0.5)[
                    0
                ]:  # the bar would be painted ten times a second
                    seen += os.read(near, 4096)
                assert seen.strip() == position
                os.write(near, b"\n")
                seen = b""
            with contextlib.suppress(OSError):  # the end of a terminal
                while more := os.read(near, 4096):
                    seen += more
            assert running.wait(timeout=300) == 0
            assert b"9 frames" in seen
        finally:
            running.kill()
            os.close(near)
