"""A whole session whose photographs come out of the real libgphoto2, and the fit of it.

The simulated bench's photograph is laid where libgphoto2's virtual camera takes its pictures from; what the rest of
labkit sees is the tethered camera's driver and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import labkit.drivers.simulated.bench
from labkit.acquisition.capture import run_plan
from labkit.analysis.fit import fit
from labkit.demo import compare
from labkit.devices.context import DeviceContext, Devices
from labkit.devices.protocols import CameraInfo, Check, ExposureSettings, RawFrame
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.gphoto2.camera import Gphoto2Camera
from labkit.drivers.gphoto2.link import Link
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.errors import DeviceError
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.session.verify import verify
from tests.plans import IPAD, PORTRAIT, plan_text, simulated

from .conftest import ContextMaker

pytest.importorskip("gphoto2")

REST_BYTES = 4096

PLAN = plan_text(
    PORTRAIT,
    {
        "lens": {"f_number": 4.0},
        "fit": {"zernike_noll": [4, 15], "reference_wavelength_nm": 450},
    },
    simulated([3000, 3300], 2950.0, "simulated:seed=3"),
    {
        "camera": {"frames_per_range": 2, "flats_per_range": 10, "darks": 4},
        "rail": {"settle_s": 0},
        "display": IPAD,
    },
)


class CameraOnTheBench:
    """The tethered camera, before whose lens the bench stands. Has a cap, which the virtual camera has not."""

    def __init__(self, camera: Gphoto2Camera, bench: Bench, photograph: Path) -> None:
        self._camera = camera
        self._bench = bench
        self._photograph = photograph
        # libgphoto2 looks at its size when it is opened, so it must not change afterwards
        sensor = bench.settings.sensor
        self._lay(np.zeros((sensor.rows, sensor.cols), dtype=np.uint16))

    def identify(self) -> CameraInfo:
        return self._camera.identify()

    def configure(self, settings: ExposureSettings) -> None:
        self._camera.configure(settings)

    def recovered(self) -> tuple[str, ...]:
        return self._camera.recovered()

    def check(self, frames: int) -> Check:
        return self._camera.check(frames)

    def cover(self, closed: bool) -> None:
        self._bench.covered = closed

    def expose(self, path: Path) -> RawFrame:
        """What the bench shows now, photographed by libgphoto2."""
        self._lay(self._bench.expose(0.02, 100, path.name + ".dng"))
        return self._camera.expose(path)

    def _lay(self, counts: NDArray[np.uint16]) -> None:
        self._photograph.unlink(missing_ok=True)
        write_raw(
            self._photograph,
            counts,
            RawTags(black_level=600, white_level=16383, exposure_s=0.02, iso=100),
        )
        # libgphoto2's virtual camera keeps the size of the first picture: those compressed vary, and a TIFF may have a rest
        size = 2 * counts.size + REST_BYTES
        self._photograph.write_bytes(self._photograph.read_bytes().ljust(size, b"\0"))


@pytest.mark.timeout(600)
def test_a_session_through_libgphoto2_is_fitted_as_well_as_the_main_job(
    tmp_path: Path, photograph: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(labkit.drivers.simulated.bench, "KEPT_PICTURES", 99)
    plan_file = tmp_path / "plan.toml"
    plan_file.write_text(PLAN)
    context = DeviceContext()
    with (
        open_devices(Plan.load(plan_file), context=context) as simulated,
        Gphoto2Camera(
            "", f_number=4.0, keep=False, wait=time.sleep, release_s=1.0
        ) as tethered,
        begin(plan_file, tmp_path / "session", resume=False) as session,
    ):
        bench: Bench = next(iter(context.shared.values()))
        camera = CameraOnTheBench(tethered, bench, photograph)
        devices = Devices(camera, simulated.rail, simulated.display, simulated.wait)  # type: ignore[arg-type]
        run_plan(session, devices, check=False)
    # more photographs than the virtual camera's card holds, so it was opened again on the way
    assert len(session.frames) == 4 + 2 * (10 + 2)
    assert verify(session) == []
    assert {frame.meta["camera_settings"]["shutterspeed"] for frame in session.frames} == {
        "0.0200s"
    }
    assert any(
        event["event"] == "camera" and event["model"] == "Nikon DSC D750"
        for event in session.events
    )
    assert _counts(session) == _counts_of_the_simulated_camera(
        plan_file, tmp_path / "simulated", bench
    )
    results = fit(session, workers=1)
    assert all(0.9 < w.chi2_per_pixel < 1.1 for w in results)
    for one in compare(results, bench.truth):
        if one.quantity.startswith("defocus"):
            assert one.estimate == pytest.approx(
                one.truth, abs=0.0012
            )  # the README's figure for simulated worlds
        if one.quantity.startswith("best focus"):
            # four standard errors, and the rail's scatter, which they do not know of
            assert abs(one.estimate - one.truth) < 4 * math.hypot(
                one.std, bench.settings.rail.scatter_mm
            )


FAULTY = Path(__file__).parents[1] / "drivers" / "faulty_gphoto2.py"


def tethered_capture(
    plan_file: Path, folder: Path, bench_room: DeviceContext, photograph: Path, **spec: Any
) -> Session:
    """Capture, or go on, through a libgphoto2 with trouble to order."""
    calls = Path(tempfile.mkdtemp(dir=folder.parent))
    link = Link([sys.executable, str(FAULTY), json.dumps({**spec, "folder": str(calls)})])
    with (
        begin(plan_file, folder, resume=True) as session,
        open_devices(session.plan, context=bench_room) as simulated,
        Gphoto2Camera(
            "", f_number=8.0, keep=False, wait=lambda s: None, link=link, release_s=1.0
        ) as tethered,
    ):
        camera = CameraOnTheBench(
            tethered, next(iter(bench_room.shared.values())), photograph
        )
        devices = Devices(camera, simulated.rail, simulated.display, simulated.wait)  # type: ignore[arg-type]
        said: list[str] = []
        run_plan(session, devices, warn=said.append)
    assert said[0].startswith("check by hand: ")
    assert "; ISO 100" in said[0]
    return session


@pytest.mark.parametrize(
    ("call", "at", "kind"),
    [
        ("init", 1, -53),
        ("trigger_capture", 2, -110),
        ("file_get", 7, -7),
        ("file_get", 12, "crash"),
    ],
)
def test_a_capture_that_the_camera_stops_is_completed_by_resuming(
    call: str,
    at: int,
    kind: int | str,
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
    photograph: Path,
) -> None:
    # two in the preflight's look at the far end, two at the near one, eleven to keep
    fault = {"call": call, "kind": kind, "at": at, "times": 999}
    with pytest.raises(DeviceError) as caught:
        tethered_capture(
            plan_file, tmp_path / "s", make_context(plan_file), photograph, fault=fault
        )
    assert "\n" not in str(caught.value)
    kept = {frame.file: frame.sha256 for frame in Session.open(tmp_path / "s").frames}
    assert len(kept) == max(0, at - 1 - 4)
    session = tethered_capture(
        plan_file, tmp_path / "s", make_context(plan_file), photograph
    )
    assert len(session.frames) == 11
    assert verify(session) == []
    assert kept.items() <= {frame.file: frame.sha256 for frame in session.frames}.items()


def test_trouble_that_the_camera_gets_over_by_itself_stands_in_the_journal(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker, photograph: Path
) -> None:
    fault = {"call": "file_get", "kind": -7, "at": 7, "times": 1}
    session = tethered_capture(
        plan_file, tmp_path / "s", make_context(plan_file), photograph, fault=fault
    )
    assert len(session.frames) == 11
    recovered = [event for event in session.events if event["event"] == "overcome"]
    assert [event["device"] for event in recovered] == ["camera"]
    assert re.match(r"photographing \w+, try 1: ", recovered[0]["error"])
    assert not [event for event in session.events if event["event"] == "trouble"]


def _counts(session: Session) -> dict[str, str]:
    """What is in each photograph, as a checksum of its pixels."""
    return {
        frame.file: hashlib.sha256(
            read_photograph(frame.path, session.plan.sensor).counts.tobytes()
        ).hexdigest()
        for frame in session.frames
    }


def _counts_of_the_simulated_camera(
    plan_file: Path, folder: Path, like: Bench
) -> dict[str, str]:
    """The same session without libgphoto2: noise is drawn by each frame's name, so nothing may differ.

    The bench is one like the other, down to the noiseless pictures that were computed for that, which take long.
    """
    bench = Bench(like.settings)
    bench._seen = like._seen
    context = DeviceContext(shared=SharedParts({"simulated:seed=3": bench}))
    with (
        begin(plan_file, folder, resume=False) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices, check=False)
    return _counts(session)
