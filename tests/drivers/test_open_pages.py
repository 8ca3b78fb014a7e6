"""Pages that labkit serves are found by another process, with their displays, and those of a dead one are not."""

from __future__ import annotations

import json

import pytest

from labkit.devices.inventory import list_connected
from labkit.drivers.web.open_pages import find_pages
from labkit.storage.files import state_folder

from .conftest import Lab


def test_pages_that_are_served_are_listed_until_they_are_closed(lab: Lab) -> None:
    left, right = lab.display(60, 80), lab.display(60, 80, "right")
    port = lab.server.port
    monitor, *displays = find_pages()
    assert monitor == ("", lab.server.url("monitor"), "the operator's page: idle")
    assert [(address, url) for address, url, _ in displays] == [
        (f"web://127.0.0.1:{port}", left.url),
        (f"web://127.0.0.1:{port}/right", right.url),
    ]
    assert displays[0][2].startswith("display of 80 × 60 pixels: no page answers")
    (file,) = (state_folder() / "pages").iterdir()
    assert file.stat().st_mode & 0o077 == 0  # its address lets one in
    left.close()
    right.close()
    assert find_pages() == []
    assert not file.exists()


def test_a_server_that_was_killed_is_not_listed(lab: Lab) -> None:
    folder = state_folder() / "pages"
    folder.mkdir(parents=True)
    (folder / "1-9.json").write_text(
        json.dumps({"url": "http://127.0.0.1:9/token/monitor", "address": "web:"})
    )
    (folder / "2-9.json").write_text("no JSON")
    assert find_pages() == []
    assert list(folder.iterdir()) == []


def test_devices_lists_them_with_the_line_for_the_plan(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labkit.devices.inventory.finders", dict)
    lab.display(60, 80)
    (_, display) = list_connected().pages
    assert display.address == f"web://127.0.0.1:{lab.server.port}"
