"""The pages are on a lab's network: requests that must not get in, where it listens, and its token."""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import socket
import stat
import urllib.request
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus

from labkit.devices.context import DeviceContext
from labkit.drivers.web import access
from labkit.drivers.web.access import kept_token
from labkit.drivers.web.address import parse_address
from labkit.drivers.web.display import WebDisplay, open_display
from labkit.drivers.web.server import reachable
from labkit.errors import DisplayError, PlanError

from .conftest import WAIT_S, Lab, plan_for
from .web_requests import ask, page

WEB = Path(__file__).parents[2] / "targets" / "web"


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
        for sink in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
        ):
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
    status, _, body = ask(
        lab, path.format(token=token, short=token[:-1], upper=token.swapcase())
    )
    assert status in (400, 404)
    assert token.encode() not in body
    assert len(body) < 100


@pytest.mark.parametrize(
    "host",
    [
        "", "evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost:{port}x",
        "127.0.0.2:{port}", "127.0.0.1:{port}@evil.example", "[", "localhost.evil:{port}",
        "127.0.0.1:{port}/evil", "127.0.0.1:{port}?evil", "127.0.0.1:{port}#evil", "evil@127.0.0.1:{port}",
    ],
)  # fmt: skip
def test_a_rebound_name_is_not_us(host: str, lab: Lab, display: WebDisplay) -> None:
    assert ask(lab, f"/{lab.server.token}/screen", host=host.format(port=lab.server.port))[
        0
    ] in (400, 404)


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
    with display, urllib.request.urlopen(display.url, timeout=WAIT_S) as answer:
        assert display.url.startswith("http://[::1]:")
        assert answer.read() == (WEB / "display.html").read_bytes()


def test_a_server_of_all_addresses_prints_one_of_the_same_kind() -> None:
    name = socket.gethostname()
    assert reachable("::") == name or ipaddress.IPv6Address(reachable("::").strip("[]"))
    assert reachable("0.0.0.0") == name or ipaddress.IPv4Address(reachable("0.0.0.0"))
    assert (reachable("10.0.0.7"), reachable("fe80::1")) == ("10.0.0.7", "[fe80::1]")


def test_our_own_names_are_us(lab: Lab, display: WebDisplay) -> None:
    for host in ("127.0.0.1", "localhost", "LOCALHOST", socket.gethostname()):
        assert (
            ask(lab, f"/{lab.server.token}/screen", host=f"{host}:{lab.server.port}")[0]
            == 200
        )


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1", None],
)
def test_a_strangers_page_gets_no_connection(
    origin: str | None, lab: Lab, display: WebDisplay
) -> None:
    for name in ("screen", "monitor"):
        with pytest.raises(InvalidStatus, match="403"):
            page(lab, name, origin=origin and origin.format(port=lab.server.port))
    if origin is not None:
        status, _, _ = ask(
            lab, f"/{lab.server.token}/screen", Origin=origin.format(port=lab.server.port)
        )
        assert status == 404


@pytest.mark.parametrize(
    "method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PROPFIND"]
)
def test_pages_can_only_be_read(method: str, lab: Lab, display: WebDisplay) -> None:
    assert ask(lab, f"/{lab.server.token}/screen", method)[0] in (400, 404, 405)


def test_a_long_head_or_body_is_cut_off(lab: Lab, display: WebDisplay) -> None:
    with contextlib.suppress(
        ConnectionResetError, BrokenPipeError
    ):  # cut off while it still speaks
        assert ask(lab, "/" + "a" * 1_000_000)[0] == 400
    status, _, body = ask(
        lab, f"/{lab.server.token}/screen", **{"Content-Length": "1000000000"}
    )
    assert status == 200  # answered, and none of the body awaited
    assert body == (WEB / "display.html").read_bytes()


@pytest.mark.parametrize(
    ("address", "where"),
    [
        ("web:", ("127.0.0.1", 8642, "screen")),
        ("web://0.0.0.0:9000", ("0.0.0.0", 9000, "screen")),
        ("web://127.0.0.1:8642/left", ("127.0.0.1", 8642, "left")),
        ("web://[::1]:1", ("::1", 1, "screen")),
    ],
)
def test_an_address_is_host_port_and_name(
    address: str, where: tuple[str, int, str]
) -> None:
    assert parse_address(address) == where


@pytest.mark.parametrize(
    "address",
    [
        "web://h:99999",
        "web://h:x",
        "web://h/a/b",
        "web://h/monitor",
        "web://h/<b>",
        "web://u:p@h",
        "web://h?x",
    ],
)
def test_another_address_is_refused_in_one_line(address: str) -> None:
    with pytest.raises(PlanError, match="allowed is web://HOST:PORT") as caught:
        parse_address(address)
    assert "\n" not in str(caught.value)


def test_without_being_asked_it_listens_on_this_machine_only(
    lab: Lab, display: WebDisplay
) -> None:
    assert parse_address("web:")[0] == "127.0.0.1"
    assert lab.server._socket.getsockname()[0] == "127.0.0.1"


def test_a_port_in_use_is_one_clear_line(lab: Lab, display: WebDisplay) -> None:
    with pytest.raises(
        DisplayError, match=f"cannot listen on 127.0.0.1 port {lab.server.port}: .*in use"
    ):
        open_display(
            f"web://127.0.0.1:{lab.server.port}", plan_for(60, 80), DeviceContext()
        )


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
    ("content", "mode"),
    [("short", 0o600), ("x" * 22, 0o644), ("../" * 10, 0o600), ("é" * 30, 0o600)],
)
def test_a_token_that_others_may_know_is_replaced(
    content: str, mode: int, tmp_path: Path
) -> None:
    (tmp_path / "web-token").write_text(content)
    (tmp_path / "web-token").chmod(mode)
    assert kept_token(tmp_path) != content
    assert (tmp_path / "web-token").read_text() == kept_token(tmp_path)
