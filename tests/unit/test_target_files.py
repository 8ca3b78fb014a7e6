"""Targets from plans and pictures, and targets as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from labkit.errors import InputError, TargetError
from labkit.plan import TargetSpec
from labkit.target.rendering import render_target
from labkit.target.target import CellTarget, open_target, read_spec
from labkit.targets.image import read_radiance
from labkit.targets.sierpinski import carpet_cells
from tests.plans import PORTRAIT, plan_text


def test_a_carpet_has_the_published_number_of_white_cells() -> None:
    for order in range(1, 6):
        cells = carpet_cells(order)
        assert cells.shape == (3**order, 3**order)
        assert cells.sum() == 9**order - 8**order


def test_a_carpets_middle_square_is_white_and_its_corners_repeat_it() -> None:
    cells = carpet_cells(3)
    assert cells[9:18, 9:18].all()
    np.testing.assert_array_equal(cells[:9, :9], carpet_cells(2))


def test_the_plan_opens_its_carpet() -> None:
    target = open_target(
        TargetSpec(kind="sierpinski", order=4, size_mm=20.0, surround="white")
    )
    assert isinstance(target, CellTarget)
    assert (target.size_mm, target.surround, target.cells.shape) == (
        (20.0, 20.0),
        1.0,
        (81, 81),
    )


def test_an_unknown_kind_of_target_names_those_installed() -> None:
    with pytest.raises(TargetError, match=r"'tartan'.*image, noise, sierpinski"):
        open_target(TargetSpec(kind="tartan", size_mm=20.0))


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [("png", np.uint8), ("png", np.uint16), ("pgm", np.uint8), ("tif", np.uint16)],
)
def test_a_picture_is_relative_radiance(
    tmp_path: Path, suffix: str, dtype: type[np.generic]
) -> None:
    full = np.iinfo(dtype).max  # type: ignore[type-var]
    picture = np.array([[0, full, full // 5], [full, 0, full // 3]], dtype=dtype)
    path = tmp_path / f"picture.{suffix}"
    (tifffile.imwrite if suffix == "tif" else lambda name, a: cv2.imwrite(str(name), a))(
        path, picture
    )
    target = open_target(TargetSpec(kind="image", file=path, size_mm=10.0))
    assert isinstance(target, CellTarget)
    assert target.size_mm == (10.0, 15.0)  # size_mm is the side of the first axis
    np.testing.assert_allclose(target.cells, picture / full)


def test_a_pgm_with_its_own_maximum_is_scaled_by_it(tmp_path: Path) -> None:
    path = tmp_path / "picture.pgm"
    path.write_bytes(b"P5\n# by hand\n3 1\n100\n" + bytes([0, 50, 100]))
    np.testing.assert_allclose(read_radiance(path), [[0.0, 0.5, 1.0]])


def colour_picture(path: Path) -> None:
    cv2.imwrite(
        str(path), np.eye(4, dtype=np.uint8)[..., None] * np.array([9, 200, 30], np.uint8)
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: path.write_text("a letter"), "is no PNG, PGM or TIFF"),
        (colour_picture, "must be grey"),
    ],
)
def test_a_bad_picture_is_refused_in_one_line(tmp_path: Path, make, says: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "picture.png"
    make(path)
    with pytest.raises(TargetError, match=says) as caught:
        read_radiance(path)
    assert "\n" not in str(caught.value)


def test_a_png_holds_every_cell_whole_and_states_its_true_size(tmp_path: Path) -> None:
    target = open_target(read_spec("sierpinski:order=3,size_mm=46.8"))
    made = render_target(target, tmp_path / "carpet.png", pixels=27 * 4)
    with Image.open(made.path) as picture:
        dots, dpi = np.asarray(picture), picture.info["dpi"]
    np.testing.assert_array_equal(dots, np.kron(carpet_cells(3), np.full((4, 4), 255)))
    # a PNG holds whole pixels per metre
    assert 108 / dpi[0] * 25.4 == pytest.approx(46.8, rel=1 / 2000)
    assert not any("whole" in note for note in made.notes)


def test_cells_that_are_no_whole_pixels_are_reported_with_the_resolution_to_ask_for(
    tmp_path: Path,
) -> None:
    target = open_target(read_spec("sierpinski:order=3,size_mm=25.4"))
    made = render_target(target, tmp_path / "carpet.png", dpi=100)
    assert made.pixels == (100, 100)
    assert "108 pixels (108.00 dpi)" in made.notes[0]


def test_a_pdf_page_is_as_large_as_the_target(tmp_path: Path) -> None:
    target = open_target(read_spec("sierpinski:order=2,size_mm=127"))
    content = render_target(target, tmp_path / "carpet.pdf").path.read_bytes()
    assert b"/MediaBox [ 0 0 360 360 ]" in content  # 127 mm = 5 inch = 360 points


def test_a_plan_names_a_target_too(tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text(PORTRAIT))
    assert read_spec(str(plan)).order == 4


@pytest.mark.parametrize(
    "text",
    [
        "sierpinski:order",
        "sierpinski:order=5",
        "sierpinski:order=99,size_mm=3",
        "sierpinski:size=3",
        "a b",
    ],
)
def test_a_bad_description_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(TargetError, match=r"an example: sierpinski:order=5,size_mm=46\.8"):
        read_spec(text)


def test_a_misspelt_name_is_named_before_what_is_missing() -> None:
    with pytest.raises(
        TargetError,
        match=r"'sierpinski:ordre=5': ordre is no known key; did you mean order\?",
    ):
        read_spec("sierpinski:ordre=5")


def test_a_picture_of_more_than_can_be_drawn_is_refused_by_its_declared_size(
    tmp_path: Path,
) -> None:
    (tmp_path / "picture.pgm").write_bytes(b"P5 8193 8193 255\n")
    with pytest.raises(
        TargetError, match="declares 8193 × 8193 pixels: allowed are 67 million in all"
    ):
        read_radiance(tmp_path / "picture.pgm")


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    target = open_target(read_spec("sierpinski:order=1,size_mm=1"))
    with pytest.raises(TargetError, match=r"\.png or \.pdf"):
        render_target(target, tmp_path / "carpet.jpg")
    with pytest.raises(TargetError, match="pixels over"):
        render_target(target, tmp_path / "carpet.png", dpi=1e9)
    with pytest.raises(InputError, match="cannot write"):
        render_target(target, tmp_path / "nowhere" / "carpet.png")
    assert list(tmp_path.iterdir()) == []
