"""A table of Zernike modes over field and wavelength as the bench's lens, and how an address orders a field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_camera, open_devices
from labkit.drivers.simulated.address import Orders, ordered
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.optics import point_spread, wavefront
from labkit.drivers.simulated.zernike_table import ZernikeTable, read_table, turned
from labkit.errors import PlanError
from labkit.plan import Plan
from tests.plans import IPAD, SMALL, plan_text, simulated

REAL = Path(__file__).parents[3] / "shared/real/lens63762/zernike_noll.csv"
NM = (450.0, 600.0)
HEADING = "wavelength_nm,field_deg," + ",".join(f"z{j}" for j in range(1, 12))


def seidel(path: Path, step_deg: float = 2.0) -> str:
    """Write a table with coma that grows with the angle, astigmatism and curvature with its square; green's is as blue's."""
    lines = [HEADING]
    for nm in NM:
        for angle in np.arange(0, 21, step_deg):
            modes = np.zeros(11)
            modes[[0, 2, 3, 5, 6, 10]] = (
                9.0,
                5.0,
                0.3 + 1e-3 * angle**2,
                4e-4 * angle**2,
                0.02 * angle,
                0.05,
            )
            lines.append(
                ",".join(f"{value:.12g}" for value in (nm, angle, *modes * 450 / nm))
            )
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_between_the_tables_angles_modes_follow_the_powers_of_the_field(
    tmp_path: Path,
) -> None:
    table = read_table(seidel(tmp_path / "modes.csv"))
    for angle in (0.7, 5.0, 19.3):
        modes = table.waves(np.tan(np.radians(angle)), np.pi / 2, 533.0)
        assert modes[4] == pytest.approx(1e-3 * angle**2, abs=1e-9)  # from the axis's
        assert modes[6] == pytest.approx(4e-4 * angle**2, abs=1e-9)
        assert modes[7] == pytest.approx(0.02 * angle, abs=1e-9)
        assert modes[11] == pytest.approx(0.05, abs=1e-9)
    assert list(modes) == list(range(4, 12))


@pytest.mark.parametrize("azimuth_deg", [0.0, 33.0, 90.0, 145.0, -120.0])
def test_a_wavefront_turns_with_the_azimuth_of_its_place(azimuth_deg: float) -> None:
    """At the azimuth's angle the pupil has what it has straight below the axis at 90 degrees."""
    rng = np.random.default_rng(2)
    below = dict(zip(range(4, 38), rng.normal(size=34), strict=True))
    here = turned(below, np.radians(azimuth_deg - 90))
    rho, theta = np.sqrt(rng.uniform(0, 1, 99)), rng.uniform(0, 2 * np.pi, 99)

    def at(modes: dict[int, float], angle: np.ndarray) -> np.ndarray:
        return wavefront(modes, rho * np.cos(angle), rho * np.sin(angle))

    np.testing.assert_allclose(
        at(here, theta + np.radians(azimuth_deg)),
        at(below, theta + np.radians(90)),
        atol=1e-12,
    )


def test_coma_points_along_the_height_at_every_azimuth(tmp_path: Path) -> None:
    terms = FieldTerms(table=read_table(seidel(tmp_path / "modes.csv")))
    for azimuth in np.radians([10, 100, 205, 300]):
        place = 3.0 * np.sin(azimuth), 3.0 * np.cos(azimuth)
        modes = terms.waves(place, 550.0, 200.0, 30.0)
        psf = point_spread({j: modes[j] for j in (7, 8)}, 550.0, 4.0, 0.5, 100)
        y, x = np.indices(psf.shape) - 100
        peak_y, peak_x = np.unravel_index(psf.argmax(), psf.shape) - np.array(100)
        tail = np.arctan2(
            (y * psf).sum() - peak_y * psf.sum(), (x * psf).sum() - peak_x * psf.sum()
        )
        # positive coma throws the tail outwards here; the peak is known to a sample
        assert np.cos(tail - azimuth) > 0.97


@pytest.mark.skipif(not REAL.exists(), reason="no real lens's table here")
def test_the_real_lens_is_interpolated_within_a_few_millionths_of_a_wave() -> None:
    whole = read_table(str(REAL))
    half = ZernikeTable(
        "half", whole.wavelengths_nm, whole.fields_deg[::2], whole.paths_nm[:, ::2]
    )
    for angle, worst in ((5, 5e-6), (11, 1e-5), (19, 3e-5)):
        true, ours = (
            one.waves(np.tan(np.radians(angle)), 0.3, 588.0) for one in (whole, half)
        )
        apart = np.sqrt(sum((true[j] - ours[j]) ** 2 for j in true))
        assert worst / 4 < apart < worst


@pytest.mark.skipif(not REAL.exists(), reason="no real lens's table here")
def test_straight_below_the_axis_the_lens_has_the_tables_own_numbers() -> None:
    lines = {
        tuple(line.split(",")[:2]): line.split(",")[2:]
        for line in REAL.read_text().splitlines()
    }
    listed = np.array(lines["588", "20"], float) * 588 / 450
    found = read_table(str(REAL)).waves(np.tan(np.radians(20)), np.pi / 2, 588.0)
    axis = float(lines["588", "0"][3]) * 588 / 450
    assert found[4] == pytest.approx(listed[3] - axis, abs=1e-12)
    np.testing.assert_allclose([found[j] for j in range(5, 38)], listed[4:], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "allowed are the columns wavelength_nm, field_deg, z1"),
        (
            HEADING + "\n" + "450,0," + ",".join("0" * 11) + "\n",
            "4 or more field angles from 0",
        ),
        (HEADING + "\n450,x\n", "cannot be read"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "modes.csv"
    path.write_text(text)
    with pytest.raises(PlanError, match=says) as refused:
        ordered(f"simulated:lens.table={path}")
    assert "\n" not in str(refused.value)


def plan(**lens: float) -> Plan:
    return Plan.parse(
        plan_text(SMALL, simulated([2000], 1950.0), {"display": IPAD, "lens": lens}), Path()
    )


def test_a_field_is_ordered_in_the_address() -> None:
    address = (
        "simulated:lens.field_curvature_per_mm=-0.006,lens.sensor_tilt_um_per_mm=2.4,-1.5,lens.k1_per_mm2=0.0009,seed=2,"
        "lens.lateral_colour=-0.00011,0,0.00018,lens.patch_px=96"
    )
    assert ordered(address) == Orders(
        2,
        field_terms={
            "field_curvature_per_mm": -0.006,
            "sensor_tilt_um_per_mm": (2.4, -1.5),
            "k1_per_mm2": 0.0009,
        },
        lateral_colour={"R": -0.00011, "G": 0.0, "B": 0.00018},
        patch_px=96.0,
    )


def test_the_field_of_the_address_is_the_benchs(tmp_path: Path) -> None:
    path = seidel(tmp_path / "modes.csv")
    context = DeviceContext()
    address = f"simulated:lens.table={path},lens.sensor_tilt_um_per_mm=20,0"
    with open_devices(plan(), simulated=address, context=context):
        (bench,) = context.shared.values()
        assert isinstance(bench, Bench)
        low, high = (bench.view.waves("G", (row, 30.0)) for row in (10.0, 50.0))
    # no random aberration beside the table, whose wavelength is that of its nearest
    assert high[11] == pytest.approx(0.05)
    assert high[4] - low[4] > 0.004


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ("lens.coma_waves=0.1", "allowed is seed=N"),
        ("lens.coma_waves=2,2", "constant coma has at most 2 waves RMS, not 2.82843"),
        ("lens.k1_per_mm2=10", "allowed is 10 % at most"),
        ("lens.sensor_tilt_um_per_mm=99999,0", "waves RMS of Noll 4: allowed is 3 at most"),
        ("lens.cos4=2", r"cos4 is 0 \(even\) to 1, not 2"),
        ("lens.cats_eye_per_mm=0.1,0", "a radius above 0, not 0"),
        ("lens.cats_eye_per_mm=20,1", "leaves a tenth of the pupil or more"),
        ("lens.patch_px=3", "over 8 pixels or more"),
        ("lens.table=/nowhere.csv", "lens.table=/nowhere.csv cannot be read"),
    ],
)
def test_a_field_that_cannot_be_is_refused_in_one_line(order: str, says: str) -> None:
    with pytest.raises(PlanError, match=says) as refused:
        open_camera(f"simulated:{order}", plan(), DeviceContext())
    assert "\n" not in str(refused.value)


def test_a_frame_beyond_the_tables_angles_is_refused(tmp_path: Path) -> None:
    path = seidel(tmp_path / "modes.csv")
    with pytest.raises(
        PlanError, match="ends at 20 degrees of field, and the frame reaches"
    ):
        open_camera(
            f"simulated:lens.table={path},lens.axis_mm=30,0", plan(), DeviceContext()
        )
