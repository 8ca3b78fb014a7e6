"""Five hundred photographs in one go: nothing may pile up while a capture runs unattended all night."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.controllers import grbl as grbl_simulator
from labkit.session.session import begin
from labkit.session.verify import verify

from .conftest import ContextMaker

FRAMES, SETTLED = 500, 150
"""By the latter, five stops in, every library is loaded and every cache full."""

CREEP_BYTES = 4 << 20
"""A photograph of this bench takes 60 KB and more as numbers: were each held on to, it would be 20 MB."""


@dataclass(frozen=True)
class Held:
    """What this process holds of the system."""

    memory_bytes: int
    threads: int
    handles: int

    @classmethod
    def now(cls) -> Held:
        proc = Path("/proc/self")
        pages = int((proc / "statm").read_text().split()[1])
        return cls(
            pages * 4096,
            len(list((proc / "task").iterdir())),
            len(list((proc / "fd").iterdir())),
        )


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts by Linux's /proc")
@pytest.mark.timeout(900)
def test_memory_threads_and_handles_stay_flat_over_500_frames(
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fast = {24: 60_000, 25: 600_000, 110: 60_000, 120: 20_000}
    monkeypatch.setattr(grbl_simulator, "LEADSCREW", grbl_simulator.LEADSCREW | fast)
    text = plan_file.read_text().replace(
        "[2000, 2050.5]", str([2000 + 5 * stop for stop in range(16)])
    )
    text = text.replace("darks = 3", "darks = 20").replace(
        "flats_per_range = 2", "flats_per_range = 12"
    )
    text = text.replace("frames_per_range = 2", "frames_per_range = 18")
    plan_file.write_text(
        text.replace(
            '[rail]\naddress = "simulated:seed=7"', '[rail]\naddress = "grbl:simulated"'
        )
    )
    held: dict[int, Held] = {}
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(
            session,
            devices,
            progress=lambda done, total, step: held.update({done: Held.now()}),
        )
    assert len(session.frames) == FRAMES
    assert verify(session) == []
    settled = [held[done] for done in range(SETTLED, FRAMES + 1)]
    early, late = settled[:50], settled[-50:]
    assert len({one.handles for one in settled}) == 1
    # the thread that ends an idle decoding process comes and goes
    assert np.ptp([one.threads for one in settled]) <= 1
    assert (
        max(one.memory_bytes for one in late) - max(one.memory_bytes for one in early)
        < CREEP_BYTES
    )
