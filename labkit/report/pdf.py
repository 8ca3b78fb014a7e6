"""The report as report.pdf, for printing and for the post: Chromium, Chrome or Edge prints the page without a window."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from labkit.errors import LabkitError, shown
from labkit.storage.files import write_atomically
from labkit.storage.reading import read_bytes

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
)
MOST_PDF_BYTES = 2**28

LEAST_VERSION = 131
"""Oldest version that prints a style sheet's running head and page number in the page's margins."""

VERSION_S, PRINT_S = 30.0, 180.0
"""After these a browser is ended. A report of a hundred fits prints in 10 s on one core."""


def write_pdf(report: Path, timeout_s: float = PRINT_S) -> Path:
    """Print report.html as report.pdf beside it, A4, whole or not at all.

    Parameters
    ----------
    report : path of report.html
    timeout_s : time after which the browser is ended

    Returns
    -------
    path of report.pdf

    Raises
    ------
    LabkitError : there is no browser that can print, or it printed nothing whole in time
    InputError : the folder cannot be written to
    """
    browser = find_browser()
    path = report.with_suffix(".pdf")
    printed = path.with_name(f".{path.name}.{os.getpid()}.printed")
    try:
        with TemporaryDirectory(
            prefix="labkit-pdf-", ignore_cleanup_errors=True
        ) as profile:
            said = _run(_command(browser, report, printed, profile), timeout_s)
        content = read_bytes(printed, MOST_PDF_BYTES) if printed.exists() else b""
    finally:
        printed.unlink(missing_ok=True)
    if not (content.startswith(b"%PDF-") and content.rstrip().endswith(b"%%EOF")):
        why = said.strip().rpartition("\n")[2]
        raise LabkitError(
            f"{browser} printed no whole PDF of {report}"
            + (f": {shown(why)}" if why else "")
            + "; print the page from a browser's own menu"
        )
    write_atomically(path, content)
    return path


def find_browser() -> str:
    """Return the path of a browser that prints pages with head and number. Raises LabkitError where there is none."""
    versions = dict[str, int]()
    for path in filter(None, map(shutil.which, BROWSERS)):
        versions[path] = _version(path)
        if versions[path] >= LEAST_VERSION:
            return path
    if not versions:
        raise LabkitError(
            "no Chromium, Chrome or Edge is installed to print a PDF: install one (Debian, Ubuntu: apt install chromium; "
            "macOS: brew install --cask google-chrome), or print report.html from another browser's menu"
        )
    newest = max(versions, key=versions.__getitem__)
    raise LabkitError(
        f"{newest} is version {versions[newest]}: page numbers need {LEAST_VERSION} or newer; update it"
    )


def _version(browser: str) -> int:
    """Return the major version of a browser; 0 if unknown."""
    with suppress(LabkitError):
        if stated := re.search(
            r"(\d{2,4})\.\d+\.\d+", _run([browser, "--version"], VERSION_S)
        ):
            return int(stated[1])
    return 0


def _command(browser: str, report: Path, printed: Path, profile: str) -> list[str]:
    """Return the command to print a page to a file. profile: a new folder, which keeps an open browser from taking over."""
    return [
        browser,
        "--headless",
        "--disable-gpu",
        "--disable-extensions",
        "--disable-background-networking",
        "--no-first-run",
        *(["--no-sandbox"] if os.geteuid() == 0 else []),  # as root it does not start else
        f"--user-data-dir={profile}",
        "--no-pdf-header-footer",
        f"--print-to-pdf={printed.resolve()}",
        report.resolve().as_uri(),
    ]


def _run(command: list[str], timeout_s: float) -> str:
    """Run a browser to its end and return its output. Raises LabkitError if the browser does not start or end."""
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise LabkitError(f"cannot start {command[0]}: {error.strerror}") from error
    with process:
        try:
            output, _ = process.communicate(timeout=timeout_s)
        except BaseException as error:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)  # its helpers too
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            raise LabkitError(
                f"{command[0]} did not end within {timeout_s:g} s; print the page from a browser's own menu"
            ) from None
    return output.decode(errors="replace")
