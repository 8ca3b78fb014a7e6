"""`labkit restore`: a session's own frames, other photographs through its lens, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from labkit.cli import run
from labkit.plan import Plan
from labkit.results import Lens, Results, Wavefront
from labkit.results.model import Focus
from labkit.uncertain import Uncertain
from tests.physics.restoration_samples import (
    FRAME,
    GAIN,
    NOLL,
    OPTICS,
    READ_NOISE,
    WAVES,
    WHITE,
    exposed,
    world,
)

BLACK, TOP = 100, 16383
PLAN = f"""
[lens]
focal_length_mm = 60.0
f_number = 5.6
[sensor]
pixel_pitch_um = {OPTICS.pitch_um}
cfa_pattern = "RGGB"
black_level = {BLACK}
white_level = {TOP}
[[channel]]
name = "R"
wavelength_nm = 650.0
[target]
kind = "sierpinski"
order = 3
size_mm = 10.0
[fit]
zernike_noll = [4, 7]
reference_wavelength_nm = 650.0
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Results of a lens that was measured in red at one range."""
    plan = Plan.parse(PLAN)
    wavefront = Wavefront(
        range_mm=1000.0,
        measured_range_mm=1000.0,
        channel="R",
        wavelength_nm=650.0,
        reference_wavelength_nm=650.0,
        f_number=OPTICS.f_number,
        noll=NOLL,
        waves=WAVES,
        covariance=1e-8 * np.eye(len(NOLL)),
        poses=np.zeros((1, 8)),
        gain=GAIN,
        read_noise=READ_NOISE,
        chi2_per_pixel=1.0,
    )
    exact = Uncertain(1.0, 0.1)
    focus = Focus({"R": Uncertain(990.0, 0.1, "mm")}, exact, True, {"R": (0.0,)})
    lens = Lens(
        Uncertain(60.0, 0.1, "mm"), Uncertain(5.2, 0.01), exact, Uncertain(0.0, 1.0, "mm")
    )
    folder = tmp_path / "session"
    Results(plan, "", (wavefront,), focus, lens).write(folder / "results" / "latest")
    return folder


def photograph(path: Path, mean: np.ndarray | None = None) -> Path:
    """A mosaic whose red pixels see the scene."""
    counts = exposed(world().mean() if mean is None else mean)
    tifffile.imwrite(path, np.clip(np.rint(counts + BLACK), 0, TOP).astype(np.uint16))
    return path


def line_of(capsys: pytest.CaptureFixture[str]) -> str:
    err = capsys.readouterr().err.strip().splitlines()
    return next(line for line in err if not line.startswith("labkit: warning"))


def test_a_photograph_is_restored_by_the_contract(session: Path, tmp_path: Path) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    assert (
        run(
            [
                "restore",
                str(image),
                "--psf",
                str(session),
                "--out",
                str(out),
                "--sixteen-bit",
                "--quiet",
            ]
        )
        == 0
    )
    about = json.loads((out / "restore.json").read_text())
    assert about["schema"] == 1
    assert about["channels"] == ["R"]
    assert about["origin_px"] == [0, 0]
    assert about["range_mm"] == 1000
    side = round(FRAME * OPTICS.pitch_um / about["spacing_um"])
    restored, std = (tifffile.imread(out / name) for name in ("restored.tif", "std.tif"))
    assert restored.dtype == std.dtype == np.float32
    assert restored.shape == std.shape == (side, side, 1)
    truth = world().truth(about["samples_per_px"])
    assert np.sqrt(np.mean((restored[..., 0] / WHITE - truth) ** 2)) < 0.15
    sixteen = tifffile.imread(out / "restored16.tif")
    np.testing.assert_allclose(sixteen, restored * 65535 / (TOP - BLACK), atol=0.51)
    with Image.open(out / "restored.png") as shown:
        assert shown.size == (side, side)


def test_tiles_are_restored_on_every_core_and_the_memory_that_is_said_counts_them(
    session: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    image, said = photograph(tmp_path / "a.tif"), list[float]()
    for name, cores in (("one", 1), ("four", 4)):
        monkeypatch.setattr(
            "labkit.jobs.execute.default_workers", lambda cores=cores: cores
        )
        out = ["--out", str(tmp_path / name), "--tile", "32"]
        assert run(["restore", str(image), "--psf", str(session), *out]) == 0
        ((tiles, photographs),) = re.findall(
            r"tiles of 32 pixels, about ([\d.]+) GB, besides ([\d.e-]+) GB of photographs",
            capsys.readouterr().out,
        )
        said.append(float(tiles))
        # counts and light in single precision, and a byte that says whether a pixel is used
        with Image.open(image) as opened:
            assert float(photographs) == pytest.approx(
                9e-9 * opened.width * opened.height, rel=0.06
            )
    assert said[1] / said[0] == pytest.approx(4, rel=0.1)  # two digits are shown


def test_a_cut_says_where_it_stands(session: Path, tmp_path: Path) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    asked = ["--crop", "8,12,40,44", "--samples", "2", "--lambda", "1000", "--quiet"]
    assert (
        run(["restore", str(image), "--psf", str(session), "--out", str(out), *asked]) == 0
    )
    about = json.loads((out / "restore.json").read_text())
    assert about["origin_px"] == [8, 12]
    assert about["spacing_um"] == pytest.approx(OPTICS.pitch_um / 2)
    assert about["lambda"]["value"] == 1000
    assert about["lambda"]["chosen_by"] == "hand"


def test_the_lens_is_carried_to_another_range(session: Path, tmp_path: Path) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    asked = ["--range", "1010", "--samples", "1", "--lambda", "1000", "--quiet"]
    assert (
        run(["restore", str(image), "--psf", str(session), "--out", str(out), *asked]) == 0
    )
    moved = json.loads((out / "restore.json").read_text())["defocus_waves"]["R"] - WAVES[0]
    # a thin lens to first order: the image moves by f^2 dr / r^2, and path over the cone's rim is that over 8 N^2
    first_order = 60.0**2 * 10 / 1005.0**2 / (8 * 5.2**2 * np.sqrt(12)) / 650e-6
    assert moved == pytest.approx(first_order, rel=0.15)


@pytest.mark.parametrize("method", ["richardson-lucy", "wiener"])
def test_the_usual_methods_are_one_option_away(
    method: str, session: Path, tmp_path: Path
) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    asked = ["--method", method, "--samples", "1", "--quiet"]
    assert (
        run(["restore", str(image), "--psf", str(session), "--out", str(out), *asked]) == 0
    )
    assert json.loads((out / "restore.json").read_text())["method"] == method


def test_a_scene_clipped_by_half_is_restored_outside_the_clipping_and_said(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mean = world().mean().copy()
    mean[:, FRAME // 2 :] = 10.0
    image, out = photograph(tmp_path / "a.tif", mean), tmp_path / "out"
    assert (
        run(
            [
                "restore",
                str(image),
                "--psf",
                str(session),
                "--out",
                str(out),
                "--samples",
                "1",
            ]
        )
        == 0
    )
    assert "50 % of the pixels are clipped" in capsys.readouterr().err
    restored = tifffile.imread(out / "restored.tif")[..., 0]
    assert np.isnan(restored[:, -16:]).all()
    assert np.isfinite(restored[:, :16]).all()


REFUSED = {
    "no lens": (["{image}"], "Give --psf SESSION"),
    "a channel that was not measured": (
        ["{image}", "--psf", "{session}", "--channel", "B"],
        "measured are R",
    ),
    "a cut outside": (
        ["{image}", "--psf", "{session}", "--crop", "0,0,99,99"],
        "rows 0 to 48",
    ),
    "a cut that is none": (
        ["{image}", "--psf", "{session}", "--crop", "1,2"],
        "first row, first column",
    ),
    "no strength": (
        ["{image}", "--psf", "{session}", "--lambda", "-3"],
        "discrepancy, or l-curve",
    ),
    "no method": (
        ["{image}", "--psf", "{session}", "--method", "magic"],
        "total-variation",
    ),
    "too little memory": (
        ["{image}", "--psf", "{session}", "--memory", "0.01", "--samples", "9"],
        "--samples, or --crop",
    ),
    "a tile too large": (
        [
            "{wide}",
            "--psf",
            "{session}",
            "--memory",
            "0.05",
            "--samples",
            "3",
            "--tile",
            "640",
        ],
        "--tile 96 fits",
    ),
    "inside the focal length": (
        ["{image}", "--psf", "{session}", "--range", "30"],
        "more than the focal length",
    ),
    "a folder that is no session": (["{folder}"], "labkit fit"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_restored_is_refused_in_one_line(
    case: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args, words = REFUSED[case]
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    wide = photograph(tmp_path / "wide.tif", np.tile(world().mean(), (5, 5)))
    given = [
        a.format(image=image, wide=wide, session=session, folder=tmp_path) for a in args
    ]
    assert run(["restore", *given, "--out", str(out)]) == 2
    assert words in line_of(capsys)
    assert not out.exists()


def test_nothing_that_was_restored_is_overwritten(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    out.mkdir()
    (out / "restore.json").write_text("{}")
    assert run(["restore", str(image), "--psf", str(session), "--out", str(out)]) == 2
    assert "another folder" in line_of(capsys)
    assert (out / "restore.json").read_text() == "{}"


def test_an_aperture_other_than_the_sessions_is_refused_unless_forced(
    session: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from labkit.photographs.exif import Exif
    from labkit.restoration import exposures

    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    monkeypatch.setattr(
        exposures, "read_exif", lambda path: Exif(camera="Other 1", f_number=11.0)
    )
    asked = [
        "restore",
        str(image),
        "--psf",
        str(session),
        "--out",
        str(out),
        "--samples",
        "1",
        "--quiet",
    ]
    assert run(asked) == 2
    assert "aperture f/11, the session's is 5.6" in line_of(capsys)
    assert run([*asked, "--force"]) == 0


def test_a_session_whose_files_went_is_named(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(session / "results")
    assert run(["restore", str(session)]) == 2
    assert "labkit fit" in line_of(capsys)


def test_another_channels_psf_is_taken_by_force_alone(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    asked = [
        "restore",
        str(image),
        "--psf",
        str(session),
        "--out",
        str(out),
        "--samples",
        "1",
        "--channel",
        "B",
    ]
    assert run(asked) == 2
    assert "--force to take another's" in line_of(capsys)
    assert run([*asked, "--force", "--quiet"]) == 0
    assert json.loads((out / "restore.json").read_text())["channels"] == ["B"]


def test_another_method_without_scikit_image_is_one_line(
    session: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "skimage", None)  # as if it were not installed
    image, out = photograph(tmp_path / "a.tif"), tmp_path / "out"
    asked = [
        "restore",
        str(image),
        "--psf",
        str(session),
        "--out",
        str(out),
        "--samples",
        "1",
    ]
    assert run([*asked, "--method", "wiener"]) == 2
    assert (
        "need scikit-image: pip install 'labkit[study]'"
        in capsys.readouterr().err.splitlines()[-1]
    )
    assert not out.exists()
