"""A camera on a network: the other end of PTP/IP (CIPA DC-005), played to libgphoto2 at a port of this machine.

It has exposure time, ISO, f-number and battery, and delivers `photograph` at each exposure, announced by an event.
"""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

MODEL, SERIAL = "Peer 1", "0815"
OK, UNSUPPORTED = 0x2001, 0x2005
UINT8, UINT16, UINT32 = 2, 4, 6
FORMATS = {UINT8: "<B", UINT16: "<H", UINT32: "<I"}
OPERATIONS = (*range(0x1001, 0x100A), 0x100B, 0x100E, 0x1014, 0x1015, 0x1016)
PROPERTIES = {
    0x5001: (UINT8, (80,)),
    0x5007: (UINT16, (280, 400, 800)),
    0x500D: (UINT32, (100, 200)),
    0x500F: (UINT16, (100, 200)),
}
STORE, NEF = 0x10001, 0x3000


def text(words: str) -> bytes:
    """A string as PTP has it."""
    return struct.pack("<B", len(words) + 1) + (words + "\0").encode("utf-16-le")


def array(values: Any, of: str = "H") -> bytes:
    """An array as PTP has it."""
    return struct.pack(f"<I{len(values)}{of}", len(values), *values)


class Peer:
    """Serves one camera until `close`. port: where; silent: it takes connections and never answers."""

    def __init__(self, photograph: Path, silent: bool = False) -> None:
        self._photograph, self._silent = photograph, silent
        self._values = {code: choices[-1] for code, (_, choices) in PROPERTIES.items()}
        self._objects: list[int] = []
        self._events: socket.socket | None = None
        self._sockets = [listener := socket.create_server(("127.0.0.1", 0))]
        self.port = listener.getsockname()[1]
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def close(self) -> None:
        """Hang up."""
        for each in self._sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                self._sockets.append(connection)
                if not self._silent:
                    threading.Thread(
                        target=self._serve, args=(connection,), daemon=True
                    ).start()

    def _serve(self, connection: socket.socket) -> None:
        with suppress(OSError, struct.error):
            while True:
                kind, body = _received(connection)
                if kind == 1:
                    name = (MODEL + "\0").encode("utf-16-le")
                    _send(
                        connection,
                        2,
                        struct.pack("<I", 1)
                        + bytes(16)
                        + name
                        + struct.pack("<I", 0x10000),
                    )
                elif kind == 3:
                    self._events = connection
                    _send(connection, 4)
                elif kind == 6:
                    _, code, transaction, *rest = struct.unpack(
                        f"<IHI{(len(body) - 10) // 4}I", body
                    )
                    sent = _data(connection) if code == 0x1016 else b""
                    self._answer(connection, transaction, *self._done(code, rest, sent))
                    if code == 0x100E:
                        self._announce(transaction)

    def _answer(
        self, connection: socket.socket, transaction: int, code: int, data: bytes | None
    ) -> None:
        if data is not None:
            _send(connection, 9, struct.pack("<IQ", transaction, len(data)))
            _send(connection, 12, struct.pack("<I", transaction) + data)
        _send(connection, 7, struct.pack("<HI", code, transaction))

    def _announce(self, transaction: int) -> None:
        """An object was added, and the exposure is complete."""
        assert self._events is not None
        self._objects.append(len(self._objects) + 1)
        _send(self._events, 8, struct.pack("<HII", 0x4002, transaction, self._objects[-1]))
        _send(self._events, 8, struct.pack("<HI", 0x400D, transaction))

    def _done(self, code: int, of: list[int], sent: bytes) -> tuple[int, bytes | None]:
        """Response and data of an operation."""
        if code == 0x1001:
            return OK, self._about()
        if code in (0x1002, 0x1003, 0x100E):
            return OK, None
        if code == 0x1004:
            return OK, array([STORE], "I")
        if code == 0x1005:
            return OK, struct.pack("<HHHQQI", 4, 2, 0, 10**10, 10**9, 150) + text(
                "card"
            ) + text("card")
        if code == 0x1007:
            return OK, array(self._objects if of[2] in (0, 0xFFFFFFFF) else [], "I")
        if code == 0x1008:
            size = self._photograph.stat().st_size
            head = struct.pack(
                "<IHHIHIIIIIIIHII",
                STORE,
                NEF,
                0,
                size,
                0x3808,
                0,
                0,
                0,
                96,
                64,
                14,
                0,
                0,
                0,
                of[0],
            )
            return OK, head + text(f"P{of[0]:07d}.NEF") + text("20260101T000000") + text(
                "20260101T000000"
            ) + text("")
        if code == 0x1009:
            return OK, self._photograph.read_bytes()
        if code == 0x100B:
            self._objects = [each for each in self._objects if each != of[0]]
            return OK, None
        if code == 0x1014:
            kind, choices = PROPERTIES[of[0]]
            values = struct.pack(
                "<" + 2 * FORMATS[kind][1], choices[0], self._values[of[0]]
            )
            form = (
                array(choices, FORMATS[kind][1])[:2] + array(choices, FORMATS[kind][1])[4:]
            )
            return OK, struct.pack(
                "<HHB", of[0], kind, len(choices) > 1
            ) + values + b"\2" + form
        if code == 0x1015:
            return OK, struct.pack(FORMATS[PROPERTIES[of[0]][0]], self._values[of[0]])
        if code == 0x1016:
            (self._values[of[0]],) = struct.unpack(FORMATS[PROPERTIES[of[0]][0]], sent)
            return OK, None
        return UNSUPPORTED, None

    def _about(self) -> bytes:
        head = struct.pack("<HIH", 100, 0, 100) + text("") + struct.pack("<H", 0)
        lists = (
            array(OPERATIONS)
            + array([0x4002, 0x400D])
            + array(list(PROPERTIES))
            + array([NEF])
            + array([NEF])
        )
        return head + lists + text("Nobody") + text(MODEL) + text("1.0") + text(SERIAL)


def _send(connection: socket.socket, kind: int, body: bytes = b"") -> None:
    connection.sendall(struct.pack("<II", 8 + len(body), kind) + body)


def _received(connection: socket.socket) -> tuple[int, bytes]:
    length, kind = struct.unpack("<II", connection.recv(8, socket.MSG_WAITALL))
    return kind, connection.recv(length - 8, socket.MSG_WAITALL)


def _data(connection: socket.socket) -> bytes:
    """What comes with a request."""
    data, kind = b"", 9
    while kind != 12:
        kind, body = _received(connection)
        data += body[4:] if kind in (10, 12) else b""
    return data
