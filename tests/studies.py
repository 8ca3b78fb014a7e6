"""A study in its quick form, through the command line and by its contract."""

import json
from pathlib import Path
from typing import Any

import pytest

from labkit.cli import run

FIELDS: dict[str, Any] = {
    "what": str,
    "measured": (int, float, type(None)),
    "unit": str,
    "n": int,
}


def quick(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run it into a folder; its one JSON object, which says what the contract wants, beside the files that it wants."""
    assert run(["study", name, "--quick", "--workers", "1", "--out", str(folder)]) == 0
    summary: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (summary["schema"], summary["study"], summary["quick"]) == (1, name, True)
    assert summary["seconds"] > 0
    assert summary["claims"]
    for claim in summary["claims"]:
        assert set(claim) == {"what", "thesis", "measured", "unit", "n"}
        assert all(isinstance(claim[key], kind) for key, kind in FIELDS.items())
    assert json.loads((folder / f"{name}.json").read_text()) == summary
    assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert len((folder / f"{name}.csv").read_text().splitlines()) > 1
    return summary
