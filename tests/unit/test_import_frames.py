"""Sessions of photographs taken elsewhere, and every way in which they can be refused: nothing is made then."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.errors import InputError, SessionError, TargetError
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.session.import_frames import import_frames
from labkit.session.session import Session
from labkit.session.verify import verify
from tests.ladders import ladder
from tests.plans import PORTRAIT, RED_AND_GREEN, SMALL, plan_text

WriteDng = Callable[..., Path]

PLAN = plan_text(PORTRAIT, RED_AND_GREEN, {"target": {"order": 3, "size_mm": 46.8}})
BLACK, WHITE, NOISE = 600, 16383, 3.0
SIZE = (126, 158)


def picture(kind: str, seed: int = 0, white: float = 9000.0) -> NDArray[np.uint16]:
    """A dark frame, an even flat, or a white square on black that fills a tenth of the frame."""
    light = np.zeros(SIZE)
    if kind == "flat":
        light[:] = white
    if kind == "target":
        light[40:80, 50:100] = white
    noise = np.random.default_rng(seed).normal(0, NOISE, SIZE)
    return np.clip(np.rint(BLACK + light + noise), 0, WHITE).astype(np.uint16)


class Folder:
    """Photographs, a CSV and a plan, ready to import; tests then spoil one thing."""

    def __init__(self, path: Path, write_dng: WriteDng) -> None:
        self.path, self.write_dng = path, write_dng
        self.rows: list[str] = []
        self.plan = PLAN
        self.session = path / "sessions" / "mine"
        self.session.parent.mkdir()
        self.add("dark.dng", "dark", None)
        self.add("flat.dng", "flat", 3000.0)
        self.add("target.dng", "target", 3000.0)

    def add(
        self,
        file: str,
        kind: str,
        range_mm: object,
        counts: NDArray[np.uint16] | None = None,
        **dng: object,
    ) -> Path:
        self.rows.append(f"{file},{kind},{'' if range_mm is None else range_mm}")
        counts = picture(kind, len(self.rows)) if counts is None else counts
        return self.write_dng(self.path / file, counts, black=BLACK, white=WHITE, **dng)

    def run(self, csv: str | None = None, encoding: str = "utf-8") -> Session:
        """Import the rows, or a CSV as it is given."""
        csv = "file,kind,range_mm\n" + "\n".join(self.rows) + "\n" if csv is None else csv
        (self.path / "plan.toml").write_text(self.plan, encoding)
        (self.path / "frames.csv").write_text(csv, encoding)
        return import_frames(
            self.path / "frames.csv", self.path / "plan.toml", self.session
        )

    def refusal(self, kind: type[InputError] = InputError, csv: str | None = None) -> str:
        """The one-line message; nothing has been made."""
        with pytest.raises(kind) as caught:
            self.run(csv)
        assert list(self.session.parent.iterdir()) == []
        assert str(caught.value).isprintable()
        return str(caught.value)


@pytest.fixture
def folder(tmp_path: Path, write_dng: WriteDng) -> Folder:
    return Folder(tmp_path, write_dng)


def test_photographs_become_a_session(folder: Folder) -> None:
    session = folder.run()
    assert [(frame.file, frame.kind, frame.range_mm) for frame in session.frames] == [
        ("dark.dng", "dark", None),
        ("flat.dng", "flat", 3000.0),
        ("target.dng", "target", 3000.0),
    ]
    assert session.frames[2].exposure_s == pytest.approx(1 / 50, rel=1e-6)
    assert session.frames[2].path.read_bytes() == (folder.path / "target.dng").read_bytes()
    assert verify(session) == []
    assert [path.name for path in folder.session.parent.iterdir()] == ["mine"]


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize(("black", "white"), [(0, 4095), (1024, 65535)])
def test_a_camera_never_met_is_imported_with_its_own_phase_depth_levels_and_orientation(
    tmp_path: Path, write_dng: WriteDng, cfa: str, black: int, white: int
) -> None:
    folder = Folder(tmp_path, write_dng)
    for name, kind in (
        ("dark.dng", "dark"),
        ("flat.dng", "flat"),
        ("target.dng", "target"),
    ):
        light = (picture(kind).astype(float) - BLACK) / (WHITE - BLACK)
        counts = np.clip(np.rint(black + light * (white - black)), 0, white).astype(
            np.uint16
        )
        write_dng(tmp_path / name, counts, cfa=cfa, black=black, white=white, orientation=6)
    session = folder.run()
    mosaic = read_photograph(session.frames[2].path, session.plan.sensor)
    assert (mosaic.cfa, mosaic.white, mosaic.black[1, 1], mosaic.counts.shape) == (
        cfa,
        white,
        black,
        SIZE,
    )


def test_rows_that_are_wrong_in_one_way_are_named_once(folder: Folder) -> None:
    rows = [f"a{k}.dng,tgt{k},3000" for k in range(40)]
    rows += (
        [f"b{k}.dng,target,{k}" for k in range(30)] + ["c.dng,target"] + ["d.dng,flat,x"]
    )
    csv = "file,kind,range_mm\n" + "\n".join(rows)
    said = folder.refusal(csv=csv)
    kinds = "allowed is target, flat, dark, bias (and 39 more lines like it)"
    ranges = "allowed is nothing, or a number of mm, not of m, above the focal length, 70 mm (and 30 more lines like it)"
    assert said == (
        f"{folder.path / 'frames.csv'}: line 2: kind 'tgt0': {kinds}; line 42: range_mm '0': {ranges}"
    )


def test_a_session_in_a_folder_that_is_not_there_is_refused(folder: Folder) -> None:
    folder.session = folder.path / "sesions" / "mine"
    with pytest.raises(
        SessionError, match=r"sesions is not there; correct the path, or make"
    ):
        folder.run()
    assert not folder.session.parent.exists()


def test_further_columns_are_kept(folder: Folder) -> None:
    session = folder.run(
        "kind,file,lens,range_mm,\n target , target.dng ,Nikkor 70,3000,\n"
    )
    assert session.frames[0].meta["columns"] == {"lens": "Nikkor 70"}


@pytest.mark.parametrize("separator", [",", ";"])
def test_csv_and_plan_of_a_spreadsheet_with_byte_order_marks_are_read(
    folder: Folder, separator: str
) -> None:
    session = folder.run(
        "file,kind,range_mm\r\ntarget.dng,target,3000\r\n".replace(",", separator),
        "utf-8-sig",
    )
    assert (session.frames[0].file, session.frames[0].range_mm) == ("target.dng", 3000.0)
    assert session.plan == Plan.parse(PLAN)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (
            f"{'a' * 140_000},target,3000",
            "line 2: not CSV: field larger than field limit (131072)",
        ),
        (f"{'a' * 100_000},target,3000", "line 2: file 'aaaa"),
        ('"target.dng,target,3000', "not CSV: unexpected end of data"),
        (
            "target.dng,target,3000,70, wide",
            "line 2: 5 cells, but the header has 3: put quotes around",
        ),
        (
            "target\x1b[2J\0.dng,target,3000",
            "line 2: file 'target\\x1b[2J\\x00.dng' is no usable path",
        ),
        (
            'target.dng,target,"3000,5"',
            "range_mm '3000,5': allowed is nothing, or a number of mm, not of m, above the focal length",
        ),
        ('target.dng,target,"3000,5"', "70 mm; write 3000.5"),
        ('target.dng,target,"3,000"', "70 mm; write 3000"),
        ("target.dng,target,3.000", "70 mm; write 3000"),
        ('target.dng,target,"3.000,0"', "70 mm; write 3000.0"),
        ("target.dng,target,3 000 mm", "70 mm; write 3000"),
        ('target.dng,target,"3,2"', "70 mm; write 3200 for 3.2 m"),
        ('target.dng,target,"0,03"', "70 mm"),
    ],
    ids=lambda value: value[:30],
)
def test_a_row_that_no_spreadsheet_would_write_is_named(
    folder: Folder, row: str, words: str
) -> None:
    message = folder.refusal(csv=f"file,kind,range_mm\n{row}\n")
    assert words in message
    assert len(message) < 400


def test_of_very_many_kinds_of_wrong_rows_the_first_are_named(folder: Folder) -> None:
    rows = [f"{'x' * k}.dng,target,{k},{','.join('y' * k)}" for k in range(1, 41)]
    message = folder.refusal(csv="file,kind,range_mm\n" + "\n".join(rows))
    assert message.count(" cells, but the header has 3") == 20
    assert message.endswith("; and 20 more problems")


def test_names_are_made_safe_and_different(folder: Folder) -> None:
    (folder.path / "a").mkdir()
    (folder.path / "b").mkdir()
    folder.add("a/mein Bild.dng", "target", 3100)
    folder.add("b/mein Bild.dng", "target", 3200)
    session = folder.run()
    assert [frame.file for frame in session.frames[3:]] == [
        "mein_Bild.dng",
        "6_mein_Bild.dng",
    ]
    assert [frame.meta["origin"] for frame in session.frames[3:]] == [
        "a/mein Bild.dng",
        "b/mein Bild.dng",
    ]


def test_ranges_may_be_left_out(folder: Folder) -> None:
    folder.rows[2] = "target.dng,target,"
    assert folder.run().frames[2].range_mm is None


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("../secret.dng,target,3000", "outside the CSV's folder"),
        ("/etc/passwd,target,3000", "outside the CSV's folder"),
        ("link/secret.dng,target,3000", "outside the CSV's folder"),
        (",target,3000", "file is empty"),
        ("target.dng,potato,3000", "kind 'potato': allowed is target, flat, dark, bias"),
        ("target.dng,target,far", "range_mm 'far'"),
        ("target.dng,target,nan", "range_mm 'nan'"),
        ("target.dng,target,69.9", "above the focal length, 70 mm"),
        ("flat.dng,target,3000", "flat.dng stands in line 3 already"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(folder: Folder, row: str, words: str) -> None:
    (folder.path / "link").symlink_to(folder.path.parent)
    folder.rows.append(row)
    message = folder.refusal()
    assert "line 5: " in message
    assert words in message


def test_all_wrong_rows_are_named_at_once(folder: Folder) -> None:
    folder.rows += ["../x.dng,target,3000", "target.dng,target,1"]
    message = folder.refusal()
    assert "line 5" in message
    assert "line 6" in message


def test_a_csv_without_the_header_says_what_it_must_hold(folder: Folder) -> None:
    assert "must hold file,kind,range_mm" in folder.refusal(csv="target.dng,target,3000\n")


def test_a_csv_without_a_target_is_refused(folder: Folder) -> None:
    del folder.rows[2]
    assert "at least one is needed" in folder.refusal()


def test_a_missing_and_a_truncated_photograph_are_both_named(folder: Folder) -> None:
    (folder.path / "flat.dng").unlink()
    target = folder.path / "target.dng"
    target.write_bytes(target.read_bytes()[:9000])
    message = folder.refusal()
    assert "flat.dng: No such file" in message
    assert "target.dng: is truncated" in message


@pytest.mark.parametrize(
    ("dng", "shape", "words"),
    [
        (
            {"model": "D2"},
            SIZE,
            "another camera than the first photograph: Acme D2, not Acme D1",
        ),
        ({}, (124, 158), "another size than the first photograph: 124×158, not 126×158"),
        (
            {"cfa": "BGGR"},
            SIZE,
            "another filter array than the first photograph: BGGR, not RGGB",
        ),
    ],
)
def test_a_raw_of_another_camera_is_refused(
    folder: Folder, dng: dict[str, str], shape: tuple[int, int], words: str
) -> None:
    folder.add("other.dng", "target", 3100, picture("target")[: shape[0]], **dng)
    assert f"other.dng is of {words}" in folder.refusal()


@pytest.mark.parametrize("kind", ["target", "flat"])
def test_an_overexposed_frame_is_refused(folder: Folder, kind: str) -> None:
    folder.add("bright.dng", kind, 3000, picture(kind, white=20000))
    assert "bright.dng is overexposed" in folder.refusal()


@pytest.mark.parametrize("kind", ["target", "flat"])
def test_a_frame_just_below_saturation_is_taken(folder: Folder, kind: str) -> None:
    # four sigma below saturation, and the noise makes some pixels saturated all the same
    folder.add("bright.dng", kind, 3000, picture(kind, white=WHITE - BLACK - 4 * NOISE))
    assert len(folder.run().frames) == 4


def test_hot_pixels_and_a_reflection_do_not_make_a_frame_overexposed(
    folder: Folder,
) -> None:
    counts = picture("target")
    counts[::20, ::20] = WHITE
    counts[:10, :30] = WHITE
    folder.add("hot.dng", "target", 3000, counts)
    assert len(folder.run().frames) == 4


@pytest.mark.parametrize("kind", ["target", "flat"])
def test_a_black_frame_is_refused_hot_pixels_or_not(folder: Folder, kind: str) -> None:
    counts = picture("dark", 9)
    counts[::20, ::20] = WHITE
    folder.add("black.dng", kind, 3000, counts)
    assert "black.dng is black" in folder.refusal()


def test_a_dim_target_is_taken(folder: Folder) -> None:
    folder.add("dim.dng", "target", 3000, picture("target", white=200))
    assert len(folder.run().frames) == 4


def test_a_dark_frame_that_has_seen_light_is_refused(folder: Folder) -> None:
    folder.add("lit.dng", "dark", None, picture("flat"))
    assert "lit.dng has seen light: it is no dark frame" in folder.refusal()


def test_a_channel_that_the_camera_lacks_is_refused(folder: Folder) -> None:
    folder.plan = plan_text(
        PORTRAIT, {"channel": [{"name": "mono", "wavelength_nm": 550.0}]}
    )
    assert "has no channel mono: its filter array is RGGB" in folder.refusal()


def test_a_target_that_cannot_be_made_is_refused(folder: Folder) -> None:
    folder.plan = PLAN.replace("sierpinski", "sierpinsky")
    assert "sierpinsky" in folder.refusal(TargetError)


KILLED = """
import os, signal, sys
from labkit.session.import_frames import import_frames
def progress(done, of, what):
    if what == "copying target.dng":
        os.kill(os.getpid(), signal.SIGKILL)
import_frames(*sys.argv[1:], progress)
"""


def test_an_import_that_was_killed_leaves_nothing_for_good(folder: Folder) -> None:
    folder.run()
    shutil.rmtree(folder.session)
    command = [sys.executable, "-c", KILLED, "frames.csv", "plan.toml", str(folder.session)]
    assert (
        subprocess.run(command, cwd=folder.path, timeout=60).returncode == -signal.SIGKILL
    )
    assert [path.name.rpartition(".")[2] for path in folder.session.parent.iterdir()] == [
        "import"
    ]
    assert len(folder.run().frames) == 3
    assert list(folder.session.parent.iterdir()) == [folder.session]


def test_an_existing_session_is_not_touched(folder: Folder) -> None:
    folder.run()
    before = (folder.session / "journal.jsonl").read_bytes()
    with pytest.raises(SessionError, match="is there already"):
        folder.run()
    assert (folder.session / "journal.jsonl").read_bytes() == before


def test_a_large_frame_is_judged_quickly(tmp_path: Path, write_dng: WriteDng) -> None:
    path = write_dng(tmp_path / "large.dng", np.tile(picture("target"), (16, 16)))
    (tmp_path / "frames.csv").write_text("file,kind,range_mm\nlarge.dng,target,\n")
    (tmp_path / "plan.toml").write_text(PLAN)
    start = time.process_time()
    import_frames(tmp_path / "frames.csv", tmp_path / "plan.toml", tmp_path / "session")
    # 5 megapixels; a raw of 45 may take ten times this
    assert path.stat().st_size > 10e6
    assert time.process_time() - start < 5


def test_ranges_in_metres_are_told(folder: Folder) -> None:
    said = folder.refusal(csv="file,kind,range_mm\ntarget.dng,target,3.2\n")
    assert "a number of mm, not of m, above the focal length, 70 mm" in said


def test_a_plan_in_the_place_of_the_list_is_told(folder: Folder) -> None:
    plan, listed = folder.path / "plan.toml", folder.path / "frames.csv"
    with pytest.raises(InputError, match="give the list first"):
        import_frames(plan, listed, folder.path / "session")


def test_flats_and_darks_alone_are_a_photon_transfer_series(tmp_path: Path) -> None:
    series = ladder(tmp_path, 1, (1e-5, 0.3, 2.0))  # black, half full, full
    listed = [
        f"{frame.file},{frame.kind},,{frame.meta['columns']['exposure_s']}"
        for frame in series.frames
    ]
    csv = tmp_path / "frames.csv"
    csv.write_text("\n".join(["file,kind,range_mm,exposure_s", *listed]), encoding="utf-8")
    levels = {"cfa_pattern": "mono", "black_level": 100, "white_level": 4095}
    plan = Plan.parse(plan_text(SMALL, {"sensor": levels}))
    session = import_frames(csv, plan, tmp_path / "session")
    assert [frame.kind for frame in session.frames] == [f.kind for f in series.frames]
    assert session.frames[0].meta["columns"] == {"exposure_s": "1e-05"}


@pytest.mark.parametrize(
    ("csv", "words"),
    [
        ("file,kind,range_mm\n" + 200_000 * "a.dng,target,0\n", "more than 20000 lines"),
        ("file,kind,range_mm\n" + 200_000 * "\n", "more than 20000 lines"),
        ("file,kind,range_mm\n" + 5_000_000 * ",", "more than 4194304 characters"),
        ("file,kind,range_mm" + 1_000_000 * "," + 900_000 * "\na", "has 1000003 columns"),
        ("file,kind,range_mm\n" + 19_000 * "a.dng,target,0\n", "(and 18999 more lines"),
    ],
    ids=lambda value: value[-20:],
)
def test_a_list_longer_than_any_is_refused_at_once_in_one_line(
    folder: Folder, csv: str, words: str
) -> None:
    before_s = time.process_time()
    message = folder.refusal(csv=csv)
    assert time.process_time() - before_s < 6  # 3 s at most, of 19,000 wrong lines
    assert words in message
    assert len(message) < 400
