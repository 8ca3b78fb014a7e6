"""The comparison of ways to fill holes."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from labkit.errors import InputError
from labkit.experiments.extension import (
    EXTERIOR,
    MINIMUM_BANDWIDTH,
    SIDE,
    Task,
    masks,
    picture,
    work,
)
from tests.studies import quick


def test_every_way_keeps_what_is_known_and_is_judged_as_scikit_image_judges() -> None:
    answer = work(Task("camera", "squares", exterior_known=True))
    assert len(answer.filled) == 4
    for name, image in answer.filled.items():
        np.testing.assert_allclose(
            image[answer.known], answer.truth[answer.known], atol=1e-12
        )
        want = peak_signal_noise_ratio(answer.truth, image, data_range=1)  # type: ignore[no-untyped-call]
        assert answer.psnr_db(name, whole=True) == pytest.approx(want)


def test_an_unknown_exterior_is_unknown() -> None:
    answer = work(Task("camera", "half", exterior_known=False))
    assert not answer.known[:EXTERIOR].any()
    assert not answer.known[:, -EXTERIOR:].any()
    # outside the interior only a smooth guess can stand
    assert answer.psnr_db(MINIMUM_BANDWIDTH, whole=True) < answer.psnr_db(
        MINIMUM_BANDWIDTH, whole=False
    )


def test_masks_leave_out_what_their_names_say() -> None:
    known = {name: mask.mean() for name, mask in masks(np.random.default_rng(0)).items()}
    # four standard deviations of a mean over 128 x 128 tosses
    assert known["half"] == pytest.approx(0.5, abs=4 * 0.5 / SIDE)
    assert known["a quarter"] == pytest.approx(0.25, abs=4 * 0.5 / SIDE)
    assert known["squares"] == 1 - (6 / 16) ** 2


def test_the_study_writes_both_figures_of_the_appendix(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = quick("extension", tmp_path, capsys)
    rows = list(csv.DictReader((tmp_path / "extension.csv").read_text().splitlines()))
    assert {row["figure"] for row in rows} == {"A.2", "A.3"}
    by_hand = [
        float(r["psnr_db"])
        for r in rows
        if r["figure"] == "A.3" and r["method"] == MINIMUM_BANDWIDTH
    ]
    claim = next(
        c
        for c in summary["claims"]
        if c["what"] == f"PSNR of {MINIMUM_BANDWIDTH}, exterior known"
    )
    assert claim["measured"] == pytest.approx(np.mean(by_hand))


def test_without_scikit_image_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "skimage", None)
    with pytest.raises(InputError, match=r"pip install 'labkit\[study\]'"):
        picture("camera")
