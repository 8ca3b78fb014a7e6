"""`labkit target serve` as a user runs it: an address on stderr, pages behind it, Ctrl-C to end it."""

import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest


@pytest.mark.timeout(400)
def test_a_target_is_served_until_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    serve = "from labkit.cli import main; main()"
    spec, panel = "sierpinski:order=4,size_mm=46.8", "ipad-9.7-retina"
    command = [
        sys.executable,
        "-c",
        serve,
        "target",
        "serve",
        spec,
        "--panel",
        panel,
        "--listen",
        "127.0.0.1:0",
    ]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        try:
            operator, display = running.stderr.readline(), running.stderr.readline()
            assert display.startswith(
                'Open this on the display "screen" (2048 × 1536 pixels): http://127.0.0.1:'
            )
            for line, title in ((display, "labkit display"), (operator, "labkit")):
                (url,) = re.findall(r"http://\S+", line)
                with urllib.request.urlopen(url, timeout=100) as page:
                    assert f"<title>{title}</title>" in page.read().decode()
            waiting = running.stderr.readline()
            assert "waiting for the display" in waiting
            running.send_signal(signal.SIGINT)
            assert running.wait(timeout=100) == 0
        finally:
            running.kill()
    assert (tmp_path / "labkit" / "web-token").read_text() in display
    assert list((tmp_path / "labkit" / "pages").iterdir()) == []
