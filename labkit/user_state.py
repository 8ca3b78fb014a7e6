"""Files that labkit keeps for a user of this machine from run to run, outside of all sessions."""

from __future__ import annotations

import os
import re
import secrets
from contextlib import suppress
from pathlib import Path


def state_folder() -> Path:
    """Return the folder for the user's state. Raises RuntimeError for a user without a home."""
    given = os.environ.get("XDG_STATE_HOME")
    return (Path(given) if given else Path.home() / ".local" / "state") / "labkit"


def kept_secret(file: Path) -> str:
    """Return the secret in a file that only the user may read.

    A new secret is made if there is none, or if others can read it. A secret that cannot be
    stored serves for this run only.
    """
    with suppress(OSError, UnicodeDecodeError):
        kept = file.read_text(encoding="ascii").strip()
        private = file.stat().st_mode & 0o077 == 0
        if private and re.fullmatch(r"[A-Za-z0-9_-]{22,64}", kept):
            return kept
    made = secrets.token_urlsafe(16)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        only_we = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(only_we, "w") as opened:
            opened.write(made)
    return made
