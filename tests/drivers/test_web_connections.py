"""The pages are on a lab's network: connections and messages that must not stop a capture."""

from __future__ import annotations

import collections
import contextlib
import itertools
import json
import socket
import struct
import threading
import time
from contextlib import ExitStack

import pytest
from websockets.exceptions import ConnectionClosed

from labkit.drivers.web import access
from labkit.drivers.web import server as web_server
from labkit.drivers.web.display import WebDisplay

from .conftest import WAIT_S, Lab, until
from .web_requests import GOOD, ask, dial, page, shows_still


@pytest.mark.parametrize(
    "text",
    [
        "", "null", "[]", "{", GOOD[:-1], GOOD.replace("80", "-80"), GOOD.replace("80", "1e999"), GOOD.replace("80", "true"),
        GOOD.replace("0123", "../."), GOOD.replace('"asked": 0', '"asked": 0, "more": 1'), GOOD.replace("1,", "NaN,", 1),
        GOOD.replace("0,", "9" * 40 + ",", 1), "x" * 1_000_000, "[" * 2000,
        b"\xff\xfe", '{"do": 5}', '{"do": "' + "x" * 99 + '"}', '{"answer": 1}', '{"answer": -1, "text": "1"}',
        '{"answer": "1", "text": "1"}', '{"answer": 1, "text": "1\\u001b[2J"}', '{"answer": 1, "text": "1\\n"}',
        '{"answer": 1, "text": "' + "1" * 25 + '"}', '{"answer": 1, "text": "1", "do": "abort"}', '{"answer": 1, "text": null}',
        '{"answer": 1, "text": "½"}', '{"answer": 1.5, "text": "1"}', '{"answer": true, "text": "1"}',
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["screen", "monitor"])
def test_a_message_that_is_none_ends_its_connection(
    name: str, text: str | bytes, lab: Lab, display: WebDisplay
) -> None:
    with page(lab, name) as wire:
        wire.send(text)
        with pytest.raises(ConnectionClosed):
            collections.deque(
                (wire.recv(timeout=WAIT_S) for _ in itertools.count()), maxlen=0
            )
    assert display._screen.report is None
    assert ask(lab, f"/{lab.server.token}/screen")[0] == 200


@pytest.mark.parametrize(
    "size", [web_server.MOST_MESSAGE_BYTES + 1, web_server.MOST_REFUSED_BYTES]
)
def test_a_page_hears_that_its_message_was_too_long(
    size: int, lab: Lab, display: WebDisplay
) -> None:
    with page(lab) as wire:
        wire.socket.sendall(
            struct.pack("!BBQL", 0x81, 0xFF, size, 0)
        )  # RFC 6455: text, its length, masked by zeros
        time.sleep(0.1)  # the server knows the length before the text has come
        wire.socket.sendall(b"x" * size)
        with pytest.raises(ConnectionClosed) as caught:
            collections.deque(
                (wire.recv(timeout=WAIT_S) for _ in itertools.count()), maxlen=0
            )
    assert caught.value.rcvd is not None
    assert caught.value.rcvd.code == web_server.TOO_LONG


def test_a_button_that_is_none_does_nothing(lab: Lab, display: WebDisplay) -> None:
    with page(lab, "monitor") as wire:
        wire.send('{"do": "rm -rf /"}')
        wire.send('{"do": "abort"}')  # no capture is running
        wire.recv(timeout=WAIT_S)
    assert lab.context.requests.empty()
    lab.server.monitor.refuse_abort()


def test_an_answer_to_no_open_question_does_nothing(
    lab: Lab, display: WebDisplay, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []
    arrived = threading.Event()
    answer = lab.server.monitor.answer

    def hear(number: int, text: str) -> None:
        answer(number, text)
        arrived.set()

    monkeypatch.setattr(lab.server.monitor, "answer", hear)
    asking = threading.Thread(target=lambda: heard.append(lab.ask("How far?")), daemon=True)
    with page(lab, "monitor") as wire:
        wire.send('{"answer": 1, "text": "too early"}')
        assert arrived.wait(WAIT_S)
        asking.start()
        while json.loads(wire.recv(timeout=WAIT_S))["question"] != {
            "number": 1,
            "text": "How far?",
            "wants": "number",
        }:
            pass
        wire.send('{"answer": 0, "text": "of another"}')
        wire.send('{"answer": 2, "text": "of the next"}')
        with page(lab, "monitor") as unknown:
            unknown.send('{"answer": 1, "text": "\\u001b]0;"}')
            with pytest.raises(ConnectionClosed):
                collections.deque(
                    (unknown.recv(timeout=WAIT_S) for _ in itertools.count()), maxlen=0
                )
        assert asking.is_alive()
        wire.send('{"answer": 1, "text": "150"}')
        asking.join(WAIT_S)
    assert heard == ["150"]


def test_a_thousand_silent_connections_stop_nothing(lab: Lab, display: WebDisplay) -> None:
    with ExitStack() as stack:
        for _ in range(10):
            for _ in range(100):
                stack.enter_context(dial(lab))
            assert shows_still(lab, display)
        held = [
            one
            for one in lab.server._server.server_state.connections
            if isinstance(one, access.Connection)
        ]
        assert len(held) <= access.MOST_UNKNOWN_CONNECTIONS + 20


@pytest.mark.parametrize(
    "start",
    [
        b"",
        b"G",
        b"GET /" + b"a" * 100,
        b"GET / HTTP/1.1\r\nHost: x\r\nX: ",
        b"\x16\x03\x01\x02",
    ],
)
def test_a_slow_stranger_is_shown_out(
    start: bytes, lab: Lab, display: WebDisplay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "UNKNOWN_CONNECTION_S", 0.3)
    with dial(lab) as wire:
        wire.sendall(start)
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while more := wire.recv(1000):  # ends, or the socket's time limit raises
                answer += more
    assert answer in (b"", b"Invalid HTTP request received.") or answer.startswith(
        b"HTTP/1.1 400 "
    )


def test_strangers_that_reset_or_never_read_stop_nothing(
    lab: Lab, display: WebDisplay
) -> None:
    deaf = dial(lab)
    deaf.sendall(
        f"GET /{lab.server.token}/page/display.js HTTP/1.1\r\nHost: 127.0.0.1:{lab.server.port}\r\n\r\n".encode()
    )
    for _ in range(50):
        wire = dial(lab)
        wire.sendall(b"GET / HT")
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        wire.close()
    assert shows_still(lab, display)
    deaf.close()


def test_a_page_that_neither_reads_nor_answers_is_let_go(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "PING_S", 0.2)
    monkeypatch.setattr(web_server, "PONG_S", 0.3)
    display = lab.display(60, 80)
    here = f"127.0.0.1:{lab.server.port}"
    with dial(lab) as wire:
        head = [
            f"GET /{lab.server.token}/monitor/socket HTTP/1.1",
            f"Host: {here}",
            f"Origin: http://{here}",
        ]
        head += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        head += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", ""]
        wire.sendall("\r\n".join(head).encode())
        monitor = lab.server.monitor
        until(lambda: bool(monitor._listeners))
        until(
            lambda: not monitor._listeners,
            lambda: monitor.noted("camera", model="x" * 10_000, serial="1"),
        )
        assert wire.recv(12) == b"HTTP/1.1 101"  # it was let in, and is gone
        assert shows_still(lab, display)


def test_what_is_no_text_does_not_silence_the_page(lab: Lab, display: WebDisplay) -> None:
    lab.server.monitor.noted(
        "camera", model="a name that is no UTF-8: \udcff", serial="\x00"
    )
    with page(lab, "monitor") as wire:
        assert "\udcff" in json.loads(wire.recv(timeout=WAIT_S))["log"][0]["text"]


def test_many_operators_pages_are_too_many(lab: Lab, display: WebDisplay) -> None:
    with ExitStack() as stack:
        for _ in range(32):
            stack.enter_context(page(lab, "monitor")).recv(timeout=WAIT_S)
        crowded = stack.enter_context(page(lab, "monitor"))
        with pytest.raises(ConnectionClosed):
            crowded.recv(timeout=WAIT_S)
        assert shows_still(lab, display)
