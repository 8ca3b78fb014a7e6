"""A real CCD's exposure series against the PyPI package `emva1288`."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import pytest

import labkit
from labkit.noise.measure import Noise
from tests.plans import SMALL, plan_text

CCD = Path(__file__).parents[3] / "shared" / "real" / "emva-ccd"

REFERENCE = {
    "gain_counts_per_e": 0.280993,
    "read_noise_e": 10.8614,
    "quantum_efficiency_percent": 45.1871,
    "saturation_e": 13227.6,
    "threshold_e": 11.4099,
    "threshold_photons": 25.2502,
    "dynamic_range": 1159.32,
    "snr_max": 115.011,
    "dark_current_e_per_s": 23.7134,
    "dsnu_whole_e": 0.516568,
    "prnu_whole_percent": 0.43315,
}
"""Of the same frames, by `python -m tests.emva1288_reference ../shared/real/emva-ccd`."""


def rows() -> Iterator[tuple[str, str, str, float, str]]:
    """Yield file, kind, range, exposure time and photons of each picture that is there."""
    kind, seconds, photons = "", 0.0, ""
    for line in (CCD / "EMVA1288_Data.txt").read_text(encoding="utf-8").splitlines():
        match line.split():
            case ["b", time_ns, number]:
                kind, seconds, photons = "flat", float(time_ns) * 1e-9, number
            case ["d", time_ns]:
                kind, seconds, photons = "dark", float(time_ns) * 1e-9, ""
            case ["i", picture]:
                file = picture.replace("\\", "/")
                if (CCD / file).exists():
                    yield file, kind, "", seconds, photons


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Noise:
    folder = tmp_path_factory.mktemp("ccd")
    (folder / "images").mkdir()
    listed = list(rows())
    for picture, *_ in listed:
        (folder / picture).write_bytes((CCD / picture).read_bytes())
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        heading = ("file", "kind", "range_mm", "exposure_s", "photons")
        csv.writer(file).writerows([heading, *listed])
    levels = {"cfa_pattern": "mono", "black_level": 0, "white_level": 4095}
    plan = folder / "plan.toml"
    plan.write_text(plan_text(SMALL, {"sensor": levels}), encoding="utf-8")
    session = labkit.import_frames(folder / "frames.csv", plan, folder / "session")
    return labkit.measure_noise(session)


@pytest.mark.slow
@pytest.mark.skipif(not CCD.is_dir(), reason="needs ../shared/real/emva-ccd")
@pytest.mark.parametrize(("name", "reference"), REFERENCE.items())
def test_a_real_ccd_has_the_numbers_of_emva1288(
    measured: Noise, name: str, reference: float
) -> None:
    number = getattr(measured["G"], name)
    # the same photographs: what differs are weights, regions and definitions
    assert abs(number.value - reference) < 2 * number.std


@pytest.mark.slow
@pytest.mark.skipif(not CCD.is_dir(), reason="needs ../shared/real/emva-ccd")
def test_a_real_ccds_gain_and_read_noise_are_close(measured: Noise) -> None:
    gain, read = (measured["G"].gain_counts_per_e, measured["G"].read_noise_e)
    assert gain.value == pytest.approx(REFERENCE["gain_counts_per_e"], rel=0.002)
    assert read.value == pytest.approx(REFERENCE["read_noise_e"], rel=0.002)
