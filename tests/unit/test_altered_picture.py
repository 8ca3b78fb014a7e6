"""Pictures that OpenCV has enlarged, smoothed or sharpened are told from those that are clean, noisy or out of focus."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm

from labkit.errors import DataError
from labkit.photographs.alterations import Alterations, alterations, edge_overshoot
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Sensor
from labkit.session.import_frames import import_frames
from labkit.types import Floats
from tests.plans import PORTRAIT, plan_text

GREY = Sensor(pixel_pitch_um=5.0, cfa_pattern="mono", black_level=0, white_level=65535)
SIDE = 448


def photograph(noise: float = 3.0, blur: float = 0.8, seed: int = 1) -> Floats:
    """A leaning carpet on an even ground, drawn twice as fine and binned, with noise that grows as photons' does."""
    fine = np.full((2 * SIDE, 2 * SIDE), 20.0)
    carpet = np.ones((1, 1))
    for _ in range(3):
        carpet = np.block(
            [
                [carpet, carpet, carpet],
                [carpet, 0 * carpet, carpet],
                [carpet, carpet, carpet],
            ]
        )
    cells = np.kron(carpet, np.ones((SIDE // 27, SIDE // 27)))
    fine[SIDE // 2 :, SIDE // 2 :][: len(cells), : len(cells)] += 150 * cells
    turn = cv2.getRotationMatrix2D((SIDE, SIDE), 3, 1)
    leaning = cv2.warpAffine(fine, turn, (2 * SIDE, 2 * SIDE), borderValue=20.0)
    light = cv2.resize(
        cv2.GaussianBlur(leaning, (0, 0), 2 * blur),
        (SIDE, SIDE),
        interpolation=cv2.INTER_AREA,
    )
    return np.asarray(
        light
        + noise
        * np.sqrt(light / 100)
        * np.random.default_rng(seed).standard_normal(light.shape)
    )


def enlarged(picture: Floats, times: float, how: int = cv2.INTER_CUBIC) -> Floats:
    return np.asarray(cv2.resize(picture, None, fx=times, fy=times, interpolation=how))


def sharpened(picture: Floats, amount: float, radius_px: float) -> Floats:
    """By an unsharp mask."""
    return np.asarray(
        picture + amount * (picture - cv2.GaussianBlur(picture, (0, 0), radius_px))
    )


def grey(folder: Path, picture: Floats) -> Photograph:
    """As PNG of 16 bit."""
    assert cv2.imwrite(
        str(folder / "a.png"), np.rint(100 * picture).clip(0, 65535).astype(np.uint16)
    )
    return read_photograph(folder / "a.png", GREY)


def developed(
    folder: Path, picture: Floats, times: float = 1.0, quality: int | None = None
) -> Photograph:
    """Sampled through a Bayer array, demosaiced by OpenCV, sRGB, enlarged, stored with 8 bit."""
    raw = np.rint(16 * picture).clip(0, 4095).astype(np.uint16)
    light = cv2.demosaicing(raw, cv2.COLOR_BayerRG2RGB_EA) / 4095.0
    stored = 255 * np.where(
        light <= 0.0031308,
        12.92 * light,
        1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055,
    )
    final = np.rint(enlarged(stored, times)).clip(0, 255).astype(np.uint8)
    name = folder / ("a.png" if quality is None else "a.jpg")
    Image.fromarray(final).save(name, quality=quality or 75)  # which PNG ignores
    return read_photograph(name, Sensor(pixel_pitch_um=5.0))


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0, 10.0])
@pytest.mark.parametrize("blur", [0.5, 0.8, 4.0])
def test_what_no_program_has_altered_is_left_in_peace(
    tmp_path: Path, noise: float, blur: float
) -> None:
    assert alterations(grey(tmp_path, photograph(noise, blur))) == Alterations()


@pytest.mark.parametrize("noise", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("blur", [0.8, 4.0])
@pytest.mark.parametrize("quality", [None, 75, 92, 98, 100])
def test_a_cameras_own_development_is_left_in_peace(
    tmp_path: Path, noise: float, blur: float, quality: int | None
) -> None:
    assert (
        alterations(developed(tmp_path, photograph(noise, blur), quality=quality))
        == Alterations()
    )


@pytest.mark.parametrize("times", [1.5, 1.7, 2.0, 3.0])
@pytest.mark.parametrize("how", [cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4])
def test_an_enlarged_picture_is_refused(tmp_path: Path, times: float, how: int) -> None:
    refusal = alterations(grey(tmp_path, enlarged(photograph(), times, how))).refusal
    assert refusal is not None
    assert "enlarged by a program" in refusal


@pytest.mark.parametrize("times", [1.25, 1.5, 2.0])
def test_an_enlarged_development_is_refused_and_so_is_one_out_of_focus(
    tmp_path: Path, times: float
) -> None:
    assert alterations(developed(tmp_path, photograph(), times)).refusal
    assert alterations(developed(tmp_path, photograph(blur=4.0), times)).refusal


def test_a_smoothed_picture_is_told_and_not_called_enlarged(tmp_path: Path) -> None:
    found = alterations(
        grey(tmp_path, np.asarray(cv2.GaussianBlur(photograph(10.0), (0, 0), 0.8)))
    )
    assert found.refusal is None
    assert "smoothed by noise reduction or by a program" in found.notes[0]


def test_an_enlarged_picture_that_was_stored_as_jpeg_is_told(tmp_path: Path) -> None:
    """JPEG hides the period with which the noise's strength repeats, and leaves that it ends below Nyquist's frequency."""
    (note,) = alterations(developed(tmp_path, photograph(8.0), 2.0, quality=80)).notes
    assert note.startswith(
        "the photographs were enlarged or smoothed by a program, or much compressed"
    )


@pytest.mark.parametrize(("amount", "radius_px"), [(0.6, 2.0), (1.5, 1.0), (1.5, 2.0)])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_sharpened_picture_is_told(
    tmp_path: Path, amount: float, radius_px: float, noise: float
) -> None:
    found = alterations(
        grey(tmp_path, sharpened(photograph(noise, 0.5), amount, radius_px))
    )
    assert "were sharpened" in found.notes[0]


@pytest.mark.parametrize("period", [2, 4, 8, 0])
def test_offsets_of_rows_and_columns_are_not_called_sharpening(
    tmp_path: Path, period: int
) -> None:
    rng = np.random.default_rng(5)
    rows, columns = rng.normal(0, 3, SIDE), rng.normal(0, 3, SIDE)
    if period:
        rows, columns = np.resize(rows[:period], SIDE), np.resize(columns[:period], SIDE)
    picture = photograph() + rows[:, None] + columns
    notes = alterations(grey(tmp_path, picture)).notes
    assert not any("sharpened" in note for note in notes)


@pytest.mark.parametrize(
    ("rows", "columns", "checks", "words"),
    [
        (3.0, 0.0, 0.0, "even and odd rows by 6;"),
        (0.0, 2.0, 0.0, "even and odd columns by 4;"),
        (0.0, 0.0, 2.0, "the two diagonals of each four pixels by 4;"),
        (3.0, 2.0, 2.0, "rows by 6, even and odd columns by 4, the two diagonals"),
        (0.3, 0.3, 0.3, ""),
    ],
)
def test_black_levels_that_differ_are_named_with_their_amount(
    tmp_path: Path, rows: float, columns: float, checks: float, words: str
) -> None:
    sign = (-1.0) ** np.arange(SIDE)
    offsets = rows * sign[:, None] + columns * sign + checks * sign[:, None] * sign
    noise = np.random.default_rng(6).normal(0, 4, (SIDE, SIDE))
    counts = np.rint(300 + offsets + noise).astype(np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), counts)
    notes = alterations(read_photograph(tmp_path / "a.png", GREY)).notes
    assert len(notes) == (1 if words else 0)
    assert words in "".join(notes)


def test_the_overshoot_of_an_edge_is_that_of_the_unsharp_mask() -> None:
    # a step under one Gaussian, less itself under two
    x = np.arange(100.0)
    step = np.tile(np.where(x < 50, 0.0, 1.0), (100, 1))
    soft = np.asarray(cv2.GaussianBlur(step, (0, 0), 1.5), dtype=np.float64)
    assert edge_overshoot(soft) == pytest.approx(0.0, abs=1e-6)
    away = np.arange(0.5, 8)  # of the pixels' centres from the edge
    crest = np.max(2 * norm.cdf(away / 1.5) - norm.cdf(away / np.hypot(1.5, 1.5)) - 1)
    # OpenCV samples its Gaussian at pixels: of 1.5 pixels, the step's slope is then off by some per cent
    assert edge_overshoot(sharpened(soft, 1.0, 1.5)) == pytest.approx(crest, rel=0.05)
    clipped = np.minimum(sharpened(soft, 1.0, 1.5), 1.0)  # the dark side has it too
    assert edge_overshoot(clipped) == pytest.approx(crest, rel=0.05)


def test_import_refuses_an_enlarged_picture_in_one_line(tmp_path: Path) -> None:
    grey(tmp_path, enlarged(photograph(), 2.0))
    (tmp_path / "plan.toml").write_text(
        plan_text(PORTRAIT, {"sensor": GREY.model_dump(exclude_unset=True)})
    )
    (tmp_path / "frames.csv").write_text("file,kind,range_mm\na.png,target,\n")
    with pytest.raises(
        DataError,
        match=r"a\.png has been enlarged by a program: [^\n]*; give the picture as the camera made it",
    ):
        import_frames(tmp_path / "frames.csv", tmp_path / "plan.toml", tmp_path / "session")
