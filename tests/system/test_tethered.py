"""A whole session whose photographs come out of the real libgphoto2, and the fit of it.

The simulated bench's photograph is laid where libgphoto2's virtual camera takes its pictures from; what the rest of
labkit sees is the tethered camera's driver and nothing else.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import pytest

from labkit.demo import compare
from labkit.drivers.bench import Bench
from labkit.drivers.dng import RawTags, write_raw
from labkit.drivers.gphoto2_camera import Gphoto2Camera
from labkit.lab.capture import capture
from labkit.lab.devices import CameraInfo, Check, Devices, ExposureSettings, RawFrame, Room
from labkit.lab.discover import open_devices
from labkit.lab.raw import read_raw
from labkit.lab.session import Session, begin, verify
from labkit.plan import load_plan
from labkit.products.wavefront import fit_session
from labkit.summary import read_results

pytest.importorskip("gphoto2")

PLAN = """
[lens]
focal_length_mm = 70.0
f_number = 4.0
[sensor]
pixel_pitch_um = 4.78
[[channel]]
name = "G"
wavelength_nm = 550.0
[target]
kind = "sierpinski"
order = 4
size_mm = 15.6
[fit]
zernike_noll = [4, 15]
reference_wavelength_nm = 450
[camera]
address = "simulated:seed=3"
exposure_s = 0.02
frames_per_range = 2
flats_per_range = 6
darks = 4
[rail]
address = "simulated:seed=3"
ranges_mm = [3000, 3150, 3300]
range_at_zero_mm = 2950.0
settle_s = 0
[display]
address = "simulated:seed=3"
panel = "ipad-9.7-retina"
"""


class CameraOnTheBench:
    """The tethered camera, before whose lens the bench stands. Has a cap, which the virtual camera has not."""

    def __init__(self, camera: Gphoto2Camera, bench: Bench, photograph: Path) -> None:
        self._camera = camera
        self._bench = bench
        self._photograph = photograph

    def identify(self) -> CameraInfo:
        return self._camera.identify()

    def configure(self, settings: ExposureSettings) -> None:
        self._camera.configure(settings)

    def check(self, frames: int) -> Check:
        return self._camera.check(frames)

    def cover(self, closed: bool) -> None:
        self._bench.covered = closed

    def expose(self, path: Path) -> RawFrame:
        """What the bench shows now, photographed by libgphoto2."""
        tags = RawTags(black_level=600, white_level=16383, exposure_s=0.02, iso=100)
        self._photograph.unlink(missing_ok=True)
        write_raw(self._photograph, self._bench.expose(0.02, 100, path.name + ".dng"), tags)
        return self._camera.expose(path)


@pytest.mark.timeout(600)
def test_a_session_through_libgphoto2_is_fitted_as_well_as_the_main_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VCAMERADIR", str(tmp_path / "vcamera"))
    photograph = tmp_path / "vcamera" / "DCIM" / "100NIKON" / "DSC_0001.JPG"
    photograph.parent.mkdir(parents=True)
    plan_file = tmp_path / "plan.toml"
    plan_file.write_text(PLAN)
    room = Room()
    said: list[str] = []
    with (
        open_devices(load_plan(plan_file), room=room) as simulated,
        Gphoto2Camera("", f_number=4.0, keep=False, wait=room.wait, release_s=1.0) as tethered,
        begin(plan_file, tmp_path / "session", resume=False) as session,
    ):
        bench: Bench = next(iter(room.shared.values()))
        photograph.write_bytes(b"")
        camera = CameraOnTheBench(tethered, bench, photograph)
        devices = Devices(camera, simulated.rail, simulated.display, simulated.wait)  # type: ignore[arg-type]
        capture(session, devices, warn=said.append)
    # more photographs than the virtual camera's card holds, so it was opened again on the way
    assert len(session.frames) == 4 + 3 * (6 + 2)
    assert verify(session) == []
    assert "check by hand: ISO 100" in said
    assert {frame.meta["camera_settings"]["shutterspeed"] for frame in session.frames} == {"0.0200s"}
    assert any(event["event"] == "camera" and event["model"] == "Nikon DSC D750" for event in session.events)
    assert _counts(session) == _counts_of_the_simulated_camera(plan_file, tmp_path / "simulated")
    fit_session(session, workers=1)
    results = read_results(session.results_folder())
    assert all(0.9 < fit["chi2_per_pixel"] < 1.1 for fit in results["wavefronts"])
    for one in compare(results, bench.truth):
        if one.quantity.startswith("defocus"):
            assert one.estimate == pytest.approx(one.truth, abs=0.0012)  # the README's figure for simulated worlds
        if one.quantity.startswith("best focus"):
            # four standard errors, and the rail's scatter, which they do not know of
            assert abs(one.estimate - one.truth) < 4 * math.hypot(one.std, bench.settings.rail.scatter_mm)


def _counts(session: Session) -> dict[str, str]:
    """What is in each photograph, as a checksum of its pixels."""
    return {
        frame.file: hashlib.sha256(read_raw(frame.path, session.plan.sensor).counts.tobytes()).hexdigest()
        for frame in session.frames
    }


def _counts_of_the_simulated_camera(plan_file: Path, folder: Path) -> dict[str, str]:
    """The same session without libgphoto2: noise is drawn by each frame's name, so nothing may differ."""
    with begin(plan_file, folder, resume=False) as session, open_devices(session.plan) as devices:
        capture(session, devices)
    return _counts(session)
