"""The pages are on a lab's network: what must not get in, and must not stop a capture."""

from __future__ import annotations

import collections
import contextlib
import hmac
import ipaddress
import itertools
import json
import socket
import stat
import struct
import threading
import time
import urllib.request
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from labkit.devices.context import DeviceContext
from labkit.drivers.web import access
from labkit.drivers.web import server as web_server
from labkit.drivers.web.access import kept_token
from labkit.drivers.web.address import parse_address
from labkit.drivers.web.display import WebDisplay, open_display
from labkit.drivers.web.server import reachable
from labkit.errors import DisplayError, PlanError

from .conftest import Lab, plan_for

WEB = Path(__file__).parents[2] / "targets" / "web"


@pytest.fixture
def display(lab: Lab) -> Iterator[WebDisplay]:
    opened = lab.display(60, 80)
    yield opened
    opened.close()


def dial(lab: Lab) -> socket.socket:
    return socket.create_connection(("127.0.0.1", lab.server.port), timeout=10)


def ask(lab: Lab, path: str, method: str = "GET", host: str | None = None, **headers: str) -> tuple[int, bytes, bytes]:
    """(status, head, body) of one request, its path sent just as it is."""
    host = f"127.0.0.1:{lab.server.port}" if host is None else host
    lines = [f"{method} {path} HTTP/1.1", f"Host: {host}", "Connection: close"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    with dial(lab) as wire:
        wire.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        answer = b"".join(iter(lambda: wire.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), head.lower(), body


def page(lab: Lab, name: str = "screen", origin: str | None = "") -> ClientConnection:
    """A page's connection, as a browser makes it; by default from our own origin."""
    here = f"127.0.0.1:{lab.server.port}"
    url = f"ws://{here}/{lab.server.token}/{name}/socket"
    whence = f"http://{here}" if origin == "" else origin
    return connect(url, origin=whence and Origin(whence), open_timeout=10, compression=None)  # type: ignore[arg-type]


def test_the_pages_own_files_are_served_as_they_are(lab: Lab, display: WebDisplay) -> None:
    token = lab.server.token
    for file in WEB.iterdir():
        status, head, body = ask(lab, f"/{token}/page/{file.name}")
        assert (status, body) == (200, file.read_bytes())
        assert b"default-src 'none'" in head
        assert b"referrer-policy: no-referrer" in head
    assert ask(lab, f"/{token}/screen")[2] == (WEB / "display.html").read_bytes()
    assert ask(lab, f"/{token}/monitor")[2] == (WEB / "monitor.html").read_bytes()


def test_no_page_names_anything_outside(lab: Lab) -> None:
    for file in WEB.iterdir():
        text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "https:" not in text
        assert "http:" not in text
        for sink in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
            assert sink not in text


@pytest.mark.parametrize(
    "path",
    [
        "/", "/screen", "/monitor", "//screen", "/wrong/screen", "/{short}/screen", "/{token}x/screen", "/{upper}/screen",
        "/%00/screen", "/\xff/screen", "/page/display.js", "/?token={token}",
        # and with the right token, what is not there
        "/{token}", "/{token}/", "/{token}/nosuch", "/{token}/page/", "/{token}/page/nosuch.js",
        "/{token}/page/../../pyproject.toml", "/{token}/page/%2e%2e/%2e%2e/pyproject.toml", "/{token}/page/..%2fimage.py",
        "/{token}/page//etc/passwd", "/{token}/page/%2fetc%2fpasswd", "/{token}/page/display.js%00.html",
        "/{token}/page/..\\image.py", "/{token}/page/sierpinski.py", "/{token}/../{token}/page/../screen/../x",
        "/{token}/screen/picture", "/{token}/monitor/frame", "/{token}/screen/socket", "http://127.0.0.1/{token}/nosuch",
    ],
)  # fmt: skip
def test_nothing_else_is_there(path: str, lab: Lab, display: WebDisplay) -> None:
    token = lab.server.token
    status, _, body = ask(lab, path.format(token=token, short=token[:-1], upper=token.swapcase()))
    assert status in (400, 404)
    assert token.encode() not in body
    assert len(body) < 100


@pytest.mark.parametrize(
    "host",
    [
        "", "evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost:{port}x",
        "127.0.0.2:{port}", "127.0.0.1:{port}@evil.example", "[", "localhost.evil:{port}",
    ],
)  # fmt: skip
def test_a_rebound_name_is_not_us(host: str, lab: Lab, display: WebDisplay) -> None:
    assert ask(lab, f"/{lab.server.token}/screen", host=host.format(port=lab.server.port))[0] in (400, 404)


def test_every_token_is_compared_in_constant_time(
    lab: Lab, display: WebDisplay, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[tuple[bytes, bytes]] = []

    class Watch:
        @staticmethod
        def compare_digest(a: bytes, b: bytes) -> bool:
            compared.append((a, b))
            return hmac.compare_digest(a, b)

    monkeypatch.setattr(access, "hmac", Watch)
    token = lab.server.token
    given = ["x", "", token[:-1], token[:-1] + "%C3%A9", token]
    answers = [ask(lab, f"/{one}/screen")[0] for one in given]
    assert answers == [404, 404, 404, 404, 200]
    assert [b for _, b in compared] == [token.encode()] * 5


def test_an_ipv6_address_is_served_as_it_is_printed(lab: Lab) -> None:
    try:
        display = open_display("web://[::1]:0", plan_for(60, 80), lab.context)
    except DisplayError:
        pytest.skip("this machine has no IPv6")
    with display, urllib.request.urlopen(display.url, timeout=10) as answer:
        assert display.url.startswith("http://[::1]:")
        assert answer.read() == (WEB / "display.html").read_bytes()


def test_a_server_of_all_addresses_prints_one_of_the_same_kind() -> None:
    name = socket.gethostname()
    assert reachable("::") == name or ipaddress.IPv6Address(reachable("::").strip("[]"))
    assert reachable("0.0.0.0") == name or ipaddress.IPv4Address(reachable("0.0.0.0"))
    assert (reachable("10.0.0.7"), reachable("fe80::1")) == ("10.0.0.7", "[fe80::1]")


def test_our_own_names_are_us(lab: Lab, display: WebDisplay) -> None:
    for host in ("127.0.0.1", "localhost", "LOCALHOST", socket.gethostname()):
        assert ask(lab, f"/{lab.server.token}/screen", host=f"{host}:{lab.server.port}")[0] == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1", None]
)
def test_a_strangers_page_gets_no_connection(origin: str | None, lab: Lab, display: WebDisplay) -> None:
    for name in ("screen", "monitor"):
        with pytest.raises(InvalidStatus, match="403"):
            page(lab, name, origin=origin and origin.format(port=lab.server.port))
    if origin is not None:
        status, _, _ = ask(lab, f"/{lab.server.token}/screen", Origin=origin.format(port=lab.server.port))
        assert status == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PROPFIND"])
def test_pages_can_only_be_read(method: str, lab: Lab, display: WebDisplay) -> None:
    assert ask(lab, f"/{lab.server.token}/screen", method)[0] in (400, 404, 405)


def test_a_long_head_or_body_is_cut_off(lab: Lab, display: WebDisplay) -> None:
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):  # cut off while it still speaks
        assert ask(lab, "/" + "a" * 1_000_000)[0] == 400
    status, _, body = ask(lab, f"/{lab.server.token}/screen", **{"Content-Length": "1000000000"})
    assert status == 200  # answered, and none of the body awaited
    assert body == (WEB / "display.html").read_bytes()


GOOD = (
    '{"page": "0123456789abcdef", "pixels": [60, 80], "exact": true, "zoom": 1, "visible": true, '
    '"shown": null, "crc": null, "disturbed": 0, "asked": 0}'
)


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
            collections.deque((wire.recv(timeout=10) for _ in itertools.count()), maxlen=0)
    assert display._screen.report is None
    assert ask(lab, f"/{lab.server.token}/screen")[0] == 200


def test_a_button_that_is_none_does_nothing(lab: Lab, display: WebDisplay) -> None:
    with page(lab, "monitor") as wire:
        wire.send('{"do": "rm -rf /"}')
        wire.send('{"do": "abort"}')  # no capture is running
        wire.recv(timeout=10)
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
        assert arrived.wait(10)
        asking.start()
        while json.loads(wire.recv(timeout=10))["question"] != {"number": 1, "text": "How far?", "wants": "number"}:
            pass
        wire.send('{"answer": 0, "text": "of another"}')
        wire.send('{"answer": 2, "text": "of the next"}')
        with page(lab, "monitor") as stranger:
            stranger.send('{"answer": 1, "text": "\\u001b]0;"}')
            with pytest.raises(ConnectionClosed):
                collections.deque((stranger.recv(timeout=10) for _ in itertools.count()), maxlen=0)
        assert asking.is_alive()
        wire.send('{"answer": 1, "text": "150"}')
        asking.join(10)
    assert heard == ["150"]


def shows_still(lab: Lab, display: WebDisplay) -> None:
    """A picture goes through to a page, whose glass is what it fetches, and comes back confirmed."""
    with page(lab) as wire:
        wire.send(GOOD)
        order = display._screen.want(np.full((60, 80), 77, dtype=np.uint8))
        body = ask(lab, f"/{lab.server.token}/screen/picture?{order.number}")[2]
        crc = zlib.crc32(np.asarray(cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_GRAYSCALE)).tobytes())
        wire.send(GOOD.replace('"shown": null, "crc": null', f'"shown": {order.number}, "crc": {crc}'))
        display._hold(lambda: display._screen.confirms(order))


def test_a_thousand_silent_connections_stop_nothing(lab: Lab, display: WebDisplay) -> None:
    with ExitStack() as stack:
        for _ in range(10):
            for _ in range(100):
                stack.enter_context(dial(lab))
            shows_still(lab, display)
        held = [one for one in lab.server._server.server_state.connections if isinstance(one, access.Connection)]
        assert len(held) <= access.MOST_STRANGERS + 20


@pytest.mark.parametrize(
    "start", [b"", b"G", b"GET /" + b"a" * 100, b"GET / HTTP/1.1\r\nHost: x\r\nX: ", b"\x16\x03\x01\x02"]
)
def test_a_slow_stranger_is_shown_out(
    start: bytes, lab: Lab, display: WebDisplay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "STRANGER_S", 0.3)
    with dial(lab) as wire:
        wire.sendall(start)
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while more := wire.recv(1000):  # ends, or the socket's time limit raises
                answer += more
    assert answer in (b"", b"Invalid HTTP request received.") or answer.startswith(b"HTTP/1.1 400 ")


def test_strangers_that_reset_or_never_read_stop_nothing(lab: Lab, display: WebDisplay) -> None:
    deaf = dial(lab)
    deaf.sendall(
        f"GET /{lab.server.token}/page/display.js HTTP/1.1\r\nHost: 127.0.0.1:{lab.server.port}\r\n\r\n".encode()
    )
    for _ in range(50):
        wire = dial(lab)
        wire.sendall(b"GET / HT")
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        wire.close()
    shows_still(lab, display)
    deaf.close()


def test_a_page_that_neither_reads_nor_answers_is_let_go(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_server, "PING_S", 0.2)
    monkeypatch.setattr(web_server, "PONG_S", 0.3)
    display = lab.display(60, 80)
    here = f"127.0.0.1:{lab.server.port}"
    with dial(lab) as wire:
        head = [f"GET /{lab.server.token}/monitor/socket HTTP/1.1", f"Host: {here}", f"Origin: http://{here}"]
        head += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        head += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", ""]
        wire.sendall("\r\n".join(head).encode())
        monitor = lab.server.monitor
        while not monitor._listeners:  # the test's own time limit ends it
            time.sleep(0.01)
        while monitor._listeners:
            monitor.noted("camera", model="x" * 10_000, serial="1")
            time.sleep(0.01)
        shows_still(lab, display)


def test_what_is_no_text_does_not_silence_the_page(lab: Lab, display: WebDisplay) -> None:
    lab.server.monitor.noted("camera", model="a name that is no UTF-8: \udcff", serial="\x00")
    with page(lab, "monitor") as wire:
        assert "\udcff" in json.loads(wire.recv(timeout=10))["log"][0]["text"]


def test_many_operators_pages_are_too_many(lab: Lab, display: WebDisplay) -> None:
    with ExitStack() as stack:
        for _ in range(32):
            stack.enter_context(page(lab, "monitor")).recv(timeout=10)
        crowded = stack.enter_context(page(lab, "monitor"))
        with pytest.raises(ConnectionClosed):
            crowded.recv(timeout=10)
        shows_still(lab, display)


# ---- addresses and the token


@pytest.mark.parametrize(
    ("address", "where"),
    [
        ("web:", ("127.0.0.1", 8642, "screen")),
        ("web://0.0.0.0:9000", ("0.0.0.0", 9000, "screen")),
        ("web://127.0.0.1:8642/left", ("127.0.0.1", 8642, "left")),
        ("web://[::1]:1", ("::1", 1, "screen")),
    ],
)
def test_an_address_is_host_port_and_name(address: str, where: tuple[str, int, str]) -> None:
    assert parse_address(address) == where


@pytest.mark.parametrize(
    "address",
    ["web://h:99999", "web://h:x", "web://h/a/b", "web://h/monitor", "web://h/<b>", "web://u:p@h", "web://h?x"],
)
def test_another_address_is_refused_in_one_line(address: str) -> None:
    with pytest.raises(PlanError, match="allowed is web://HOST:PORT") as caught:
        parse_address(address)
    assert "\n" not in str(caught.value)


def test_without_being_asked_it_listens_on_this_machine_only(lab: Lab, display: WebDisplay) -> None:
    assert parse_address("web:")[0] == "127.0.0.1"
    assert lab.server._socket.getsockname()[0] == "127.0.0.1"


def test_a_port_in_use_is_one_clear_line(lab: Lab, display: WebDisplay) -> None:
    with pytest.raises(DisplayError, match=f"cannot listen on 127.0.0.1 port {lab.server.port}: .*in use"):
        open_display(f"web://127.0.0.1:{lab.server.port}", plan_for(60, 80), DeviceContext())


def test_two_displays_of_one_name_are_refused(lab: Lab, display: WebDisplay) -> None:
    with pytest.raises(PlanError, match='two displays are called "screen"'):
        lab.display(60, 80)


def test_the_token_is_kept_where_only_its_user_reads_it(tmp_path: Path) -> None:
    token = kept_token(tmp_path / "new" / "labkit")
    file = tmp_path / "new" / "labkit" / "web-token"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert len(token) >= 22
    assert kept_token(tmp_path / "new" / "labkit") == token


@pytest.mark.parametrize(
    ("content", "mode"), [("short", 0o600), ("x" * 22, 0o644), ("../" * 10, 0o600), ("é" * 30, 0o600)]
)
def test_a_token_that_others_may_know_is_replaced(content: str, mode: int, tmp_path: Path) -> None:
    (tmp_path / "web-token").write_text(content)
    (tmp_path / "web-token").chmod(mode)
    assert kept_token(tmp_path) != content
    assert (tmp_path / "web-token").read_text() == kept_token(tmp_path)
