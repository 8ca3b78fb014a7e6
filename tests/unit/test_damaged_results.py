"""Results that were damaged or forged: one line, and no more memory than results need."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.errors import DataError
from labkit.report.html import write_report
from labkit.results import Results
from labkit.storage import npz
from tests.results_contracts import CONTRACT_3, printed
from tests.results_samples import full_results, some_results, written


def test_residuals_with_any_bit_flipped_are_read_or_refused_in_one_line(
    tmp_path: Path,
) -> None:
    file = written(tmp_path) / "residuals.npz"
    whole, rng, refused = file.read_bytes(), np.random.default_rng(3), []
    for at in rng.integers(8 * len(whole), size=100):
        damaged = bytearray(whole)
        damaged[at // 8] ^= 1 << int(at % 8)
        file.write_bytes(damaged)
        try:
            Results.load(file.parent)
        except DataError as error:
            refused.append(str(error))
    assert len(refused) > 90  # zip's checksums hold all but its unused fields
    line = re.compile(rf"cannot read {file}: .*; fit the session again")
    assert [text for text in refused if not line.fullmatch(text)] == []


def test_residuals_larger_than_the_photographs_are_not_unpacked(tmp_path: Path) -> None:
    file = written(tmp_path) / "residuals.npz"
    file.write_bytes(npz.packed({"data_3000_R": np.zeros((2, 1, 1000, 1000))}))
    with pytest.raises(DataError, match="takes more than 11520 bytes"):  # 2 × 24 × 30
        Results.load(file.parent)


def test_the_arrays_of_a_file_have_one_limit_together_whatever_results_json_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of 4 MB took 8.3 GB: the limit of each array came from results.json, and there was none for all."""
    file = written(tmp_path) / "residuals.npz"
    changed(file.parent / "results.json", "wavefronts.0.shape_px", [2**12, 2**12])
    array = np.zeros((2, 1, 2**8, 2**12), np.float32)
    names = [f"{part}_3000_R" for part in ("data", "model", "sigma")]
    file.write_bytes(npz.packed(dict.fromkeys(names, array)))
    monkeypatch.setattr(npz, "MOST_BYTES", 2 * array.nbytes + 1)
    tracemalloc.start()
    with pytest.raises(DataError, match="its arrays take more than 16777217 bytes"):
        Results.load(file.parent)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 3.5 * array.nbytes  # two arrays, one of which grew


def test_a_header_that_states_another_size_than_the_array_has_is_refused(
    tmp_path: Path,
) -> None:
    file = written(tmp_path) / "residuals.npz"
    for stated, kept in ((40, 4_000_000), (1440, 10), (10**9, 10)):
        buffer = io.BytesIO()
        np.lib.format.write_array(buffer, np.zeros(kept))
        header = buffer.getvalue().replace(b"(%d,)" % kept, b"(%d,)" % stated)
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("data_3000_R.npy", header)
        with pytest.raises(DataError, match=r"is not whole|takes more than 11520 bytes"):
            Results.load(file.parent)


def test_a_file_of_a_million_arrays_is_refused_at_once(tmp_path: Path) -> None:
    one = io.BytesIO()
    with zipfile.ZipFile(one, "w") as archive:
        archive.writestr("a.npy", b"")
    content = one.getvalue()
    local, rest = content.split(b"PK\1\2")
    entry = b"PK\1\2" + rest.split(b"PK\5\6")[0]
    end = struct.pack(
        "<4s4H2LH", b"PK\5\6", 0, 0, 65535, 65535, 10**6 * len(entry), len(local), 0
    )
    with pytest.raises(ValueError, match="its list of arrays cannot be read"):
        npz.unpacked(local + 10**6 * entry + end, lambda _: 10)


@pytest.mark.parametrize(
    "array", [np.zeros((24, 30)), np.zeros((2, 1, 0, 30)), np.array(["a"]), np.zeros(3) > 0]
)
def test_residuals_of_another_kind_give_one_line(tmp_path: Path, array: Any) -> None:
    names = [f"{part}_3000_R" for part in ("data", "model", "sigma")]
    file = written(tmp_path) / "residuals.npz"
    file.write_bytes(npz.packed(dict.fromkeys(names, array)))
    with pytest.raises(DataError, match="cannot read"):
        Results.load(file.parent)


@pytest.mark.parametrize("plan", [{"lens": {}}, [], "plan", {"k": 1} | {"lens": 1}])
def test_a_plan_that_cannot_be_read_gives_one_short_line(tmp_path: Path, plan: Any) -> None:
    with pytest.raises(DataError, match="the plan in it cannot be read: ") as caught:
        printed(tmp_path, CONTRACT_3 | {"plan": plan})
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


HUGE, NOT_FINITE = 10**400, float("inf")


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        ("wavefronts.0.noll.0", NOT_FINITE, "valid integer"),
        ("wavefronts.0.noll.1", 4, "a mode twice"),
        ("wavefronts.0.waves_rms.0", HUGE, "wavefronts.0.waves_rms.0"),
        ("wavefronts.0.waves_rms.0", None, "valid number"),
        ("wavefronts.0.waves_rms", [0.1], "1 numbers in waves_rms for 3 modes"),
        ("wavefronts.0.range_mm", float("nan"), "wavefronts.0.range_mm"),
        ("wavefronts.0.range_mm", -1.0, "greater than 0"),
        ("wavefronts.0.wavelength_nm", 1e-300, "wavelength_nm = 1e-300"),
        ("wavefronts.0.f_number", 1e300, "f_number = 1e+300"),
        ("wavefronts.0.covariance.0.1", 5e-7, "is not symmetric"),
        ("wavefronts.0.covariance.0.0", -1.0, "variance below 0"),
        ("wavefronts.0.covariance.0", [1.0], "inhomogeneous"),
        ("wavefronts.0.poses", [[0.0]], "poses.0"),
        ("wavefronts.0.shape_px", [10**9, 1], "shape_px.0 = 1000000000"),
        ("wavefronts.0.spectrum", [[0.0, 1.0]], "spectrum.0.0"),
        ("wavefronts.0.model.residual_spectrum.power", [], "different lengths"),
        ("wavefronts.0.std", [0.1], "1 numbers in std for 3 modes"),
        ("wavefronts.0.std.1", 0.5, "std other than the roots"),
        ("wavefronts.0.std.1", -0.5, "std.1 = -0.5"),
        ("wavefronts.0.covariance", [[1e-6]], "covariance of shape (1, 1) for 3 modes"),
        ("wavefronts.0.covariance.0.1", None, "an unknown number between known"),
        ("wavefronts.0.pulls", [0.1, 0.2], "2 numbers in pulls for 3 modes"),
        ("wavefronts.0.global_test.others.0.waves_rms", [], "others.0.waves_rms"),
        ("wavefronts.0.frames", ["a"] * 3, "3 frames and 2 poses"),
        ("wavefronts.0.corners_px", [[[0.0, 1.0]] * 4], "1 corners_px and 2 poses"),
        ("wavefronts.0.key.range_mm", 1000.0, "has the key of R at 1000 mm"),
        ("wavefronts.0.key.channel", "B", "has the key of B at 3000 mm"),
        ("wavefronts.0.lambda_n_um.value", 0.0, "lambda_n_um.value = 0.0"),
        ("wavefronts.0.lambda_n_um.value", None, "lambda_n_um.value"),
        ("wavefronts.0.lambda_n_um.value", 18.0, "lambda_n_um = 18; its wavelength"),
        ("wavefronts.0.f_number_working.value", 0.0, "f_number_working.value = 0.0"),
        ("wavefronts.0.gain", -1.0, "gain = -1.0"),
        ("wavefronts.0.read_noise", -1.0, "read_noise = -1.0"),
        ("wavefronts.0.chi2_per_pixel", -1.0, "chi2_per_pixel = -1.0"),
        ("wavefronts.0.global_test.p_value", 1.5, "p_value = 1.5"),
        ("reference_wavelength_nm", 600.0, "the plan in it has 450"),
        ("lens.range_zero_mm.value", None, "range_zero_mm.value"),
        ("common.stated.f-number.std", -0.1, "stated.f-number.std = -0.1"),
        ("common.covariance.0.1", 1e9, "is not symmetric"),
        ("field.sensor_tilt_um_per_mm.covariance.0.1", 9.0, "is not symmetric"),
        ("budget", {"x": {"y": -1.0}}, "budget.x.y = -1.0"),
        ("focus.covariance", [[1.0]], "has shape"),
        ("focus.best_focus_mm.R.std", -1.0, "greater than or equal to 0"),
        ("lens.f_number.value", 0.0, "greater than 0"),
        ("lens.f_number", 2.8, "lens.f_number = 2.8"),
        ("findings.0.where.tile", [1], "tile"),
        ("budget", {"x": "y"}, "budget.x = 'y'"),
    ],
)
def test_a_value_that_cannot_be_is_named(
    tmp_path: Path, where: str, value: Any, words: str
) -> None:
    folder = tmp_path / "results" / "latest"
    file = full_results().write(folder)
    changed(file, where, value)
    with pytest.raises(DataError, match=re.escape(words)) as caught:
        Results.load(tmp_path)
    assert "is not as schema 3 has it" in str(caught.value)
    assert len(str(caught.value)) < 600


def test_the_covariance_of_a_field_that_is_none_gives_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "latest"
    full_results().write(folder)
    file = folder / "field.npz"
    whole = np.load(file)["covariance"]
    damages: tuple[tuple[Callable[[Any], Any], str], ...] = (
        (lambda c: c.__setitem__((0, 1), 9.0), "is not symmetric"),
        (lambda c: c.__setitem__((0, 0), -1.0), "a variance below 0"),
        (lambda c: c.__imul__(4.0), "other standard errors than their covariance"),
    )
    for damage, words in damages:
        covariance = whole.copy()
        damage(covariance)
        file.write_bytes(npz.packed({"covariance": covariance}))
        with pytest.raises(DataError, match=words):
            Results.load(tmp_path)


def changed(file: Path, where: str, value: Any) -> None:
    """Put another value into results.json."""
    content = json.loads(file.read_text())
    inner, steps = content, [int(s) if s.isdigit() else s for s in where.split(".")]
    for step in steps[:-1]:
        inner = inner[step]
    inner[steps[-1]] = value
    file.write_text(json.dumps(content))


def test_a_report_of_numbers_of_no_lens_is_refused_in_one_line(tmp_path: Path) -> None:
    changed(some_results().write(tmp_path), "lens.f_number.value", 1e9)
    with pytest.raises(DataError, match="no report can be made of") as caught:
        write_report(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_residual_that_is_not_known_is_reported(tmp_path: Path) -> None:
    changed(some_results().write(tmp_path), "focus.residual_waves.R.0", None)
    assert write_report(tmp_path).exists()


def flipped(text: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(text)
    damaged[rng.randrange(len(text))] ^= 1 << rng.randrange(7)
    return bytes(damaged)


def cut(text: bytes, rng: random.Random) -> bytes:
    first, second = sorted(rng.sample(range(len(text)), 2))
    return text[:first] + text[second:]


def another_value(text: bytes, rng: random.Random) -> bytes:
    """One number, text or word in another's place."""
    values = list(re.finditer(rb'-?\d[-+.e\d]*|"[^"]*"|true|false|null', text))
    at = rng.choice(values)
    other = rng.choice(
        [b"null", b"-1", b"1e308", b"1e-308", b"NaN", b"[]", b"{}", b"9" * 400, b"true"]
    )
    return (
        text[: at.start()] + rng.choice([other, rng.choice(values)[0]]) + text[at.end() :]
    )


@pytest.mark.parametrize("damage", [flipped, cut, another_value])
def test_results_damaged_at_random_are_read_or_refused_in_one_line(
    tmp_path: Path, damage: Callable[[bytes, random.Random], bytes]
) -> None:
    file = full_results().write(tmp_path)
    (tmp_path / "residuals.npz").unlink()
    whole, rng = file.read_bytes(), random.Random(11)
    said = []
    for _ in range(100):
        file.write_bytes(damage(whole, rng))
        try:
            Results.load(tmp_path)
        except DataError as error:
            said.append(str(error))
    assert said
    assert max(map(len, said)) < 1000
    assert not [line for line in said if "\n" in line]
