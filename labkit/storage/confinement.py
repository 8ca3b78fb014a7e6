"""Take from this process for good what decoding a file does not need: to write files, to run programs, the network.

Linux lets every process do this, by Landlock and by a network of its own. No library for it is well kept, and it takes
four system calls. Elsewhere, and on a kernel without them, the limits of `labkit.storage.apart` are all there is.

Landlock: docs.kernel.org/userspace-api/landlock.html, versions 1 to 6 of its interface.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from contextlib import suppress

CREATE_RULESET = 444
RESTRICT_SELF = 446
ASK_VERSION = 1
"""Flag of `CREATE_RULESET`."""

NO_NEW_PRIVILEGES = 38
"""Of prctl: without it only root may restrict itself."""

NEW_USER = 0x10000000
NEW_NETWORK = 0x40000000
"""Flags of unshare."""

WRITING = {
    1: 0b1_1111_1111_0011,  # run, write, remove, and make files of any kind
    2: 1 << 13,  # link and rename into another folder
    3: 1 << 14,  # truncate
    5: 1 << 15,  # control devices
}
"""Rights on files to give up, by the version of Landlock that knows them first; reading is bits 2 and 3."""

FIRST_WITH_NETWORK, TCP = 4, 0b11
FIRST_WITH_SCOPES, OTHER_PROCESSES = 6, 0b11
"""Abstract sockets of other processes, and signals to them."""


def confine() -> None:
    """Give up writing, programs and the network, as far as the system allows. Descriptors that are open stay."""
    if not sys.platform.startswith("linux"):
        return
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None, use_errno=True)
        # an empty network needs the rights of root, which a user has in a name space of the user's own
        alone = NEW_NETWORK if os.geteuid() == 0 else NEW_USER | NEW_NETWORK
        library.unshare(alone)
        _restrict(library)


def _restrict(library: ctypes.CDLL) -> None:
    """Give up rights by Landlock; do nothing where the kernel lacks it."""
    version = library.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ASK_VERSION)
    if version < 1:
        return
    files = sum(rights for first, rights in WRITING.items() if version >= first)
    rules = [files]
    if version >= FIRST_WITH_NETWORK:
        rules.append(TCP)
    if version >= FIRST_WITH_SCOPES:
        rules.append(OTHER_PROCESSES)
    given_up = struct.pack(f"={len(rules)}Q", *rules)
    ruleset = library.syscall(CREATE_RULESET, given_up, ctypes.c_size_t(len(given_up)), 0)
    if ruleset < 0:
        return
    try:
        library.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
        library.syscall(RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)
