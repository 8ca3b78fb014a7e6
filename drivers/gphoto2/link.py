"""The near end of the pipe to libgphoto2's process: starts the process, sends requests, kills it if it hangs."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from labkit.errors import CameraError

WORKER_COMMAND = (sys.executable, "-m", "labkit.drivers.gphoto2.worker")

FULL, UNSUPPORTED, IO, TIMEOUT, UNPLUGGED, CLAIM, NO_CAMERA, BUSY = (
    -3,
    -6,
    -7,
    -10,
    -52,
    -53,
    -105,
    -110,
)
"""Codes of libgphoto2 and its ports."""

HUNG, DIED = 1, 2
"""Codes of troubles that libgphoto2 cannot report itself."""

KILL_S = 5.0
"""A process stuck in the kernel cannot be killed: labkit waits this long, then abandons the process."""


class Trouble(CameraError):  # noqa: N818
    """The library failed. code: libgphoto2's, HUNG or DIED, 0 for any other trouble."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class Link:
    """Sends one request at a time. After HUNG or DIED the next request starts a new process."""

    def __init__(self, command: Sequence[str] = WORKER_COMMAND) -> None:
        self._command = tuple(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: Connection | None = None
        self._asked = 0

    def ask(self, do: str, limit_s: float, **arguments: Any) -> Any:
        """Return the worker's answer to a request. Raises Trouble, HUNG if the answer takes longer than `limit_s`."""
        channel = self._open()
        self._asked += 1
        request = {"id": self._asked, "do": do, "with": arguments, "limit_s": limit_s}
        end = time.monotonic() + limit_s
        try:
            channel.send_bytes(json.dumps(request).encode())
            while True:
                if not channel.poll(max(0.0, end - time.monotonic())):
                    self.kill()
                    raise Trouble(
                        HUNG,
                        f"libgphoto2 did not come back from '{do}' within {limit_s:g} s",
                    )
                answer = json.loads(channel.recv_bytes())
                if answer["id"] == self._asked:  # else to a question that was broken off
                    break
        except (EOFError, OSError) as error:
            raise Trouble(
                DIED, f"libgphoto2 crashed in '{do}'{self._last_words()}"
            ) from error
        if "error" in answer:
            raise Trouble(answer["code"], answer["error"])
        return answer["value"]

    def kill(self) -> None:
        """Kill the process, whatever it does."""
        process = self._process
        self._process = None
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        if process is not None:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(KILL_S)

    def close(self, limit_s: float) -> None:
        """Let the camera go and end the process; again does nothing."""
        if self._process is None:
            return
        with contextlib.suppress(Trouble):
            self.ask("close", limit_s)
        self.kill()

    def _open(self) -> Connection:
        if self._channel is None:
            near, far = Pipe()
            with far:
                # in a session of its own a Ctrl-C at the terminal does not reach it
                self._process = subprocess.Popen(
                    [*self._command, str(far.fileno())],
                    pass_fds=[far.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            self._channel = near
        return self._channel

    def _last_words(self) -> str:
        """Describe the end of the process, and clear up after it."""
        process = self._process
        status = None
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                status = process.wait(KILL_S)
        self.kill()
        return (
            f" (signal {-status})"
            if status is not None and status < 0
            else f" (exit status {status})"
        )
