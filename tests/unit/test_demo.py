"""Results beside the truth of a simulated bench."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from labkit.cli import bench, sessions
from labkit.cli.app import app
from labkit.demo import Comparison, compare, compare_wavefronts, new_folder, next_steps
from labkit.results import Lens
from labkit.uncertain import Uncertain
from tests.results_samples import a_wavefront, some_results

assert bench
assert sessions  # they add their commands to the app


def test_estimates_stand_beside_the_truth_of_their_own_range_and_channel() -> None:
    visits = [
        SimpleNamespace(range_mm=r, defocus_waves={"R": w})
        for r, w in ((2000.0, 9.0), (3000.0, -0.302))
    ]
    truth = SimpleNamespace(
        best_focus_mm={"R": 2986.0, "B": 2987.0}, pupil_magnification=0.985, visits=visits
    )
    red, blue, magnification, defocus = compare(
        some_results(wavefronts=(a_wavefront(defocus=-0.3),), lens=None), truth
    )
    assert (red.truth, red.estimate, red.std) == (2986.0, 2986.84, 0.42)
    assert (blue.truth, blue.estimate) == (2987.0, 2987.31)
    assert (magnification.truth, magnification.estimate) == (0.985, 0.981)
    assert (defocus.truth, defocus.estimate, defocus.std) == (-0.302, -0.3, 0.0011)


def test_the_lens_stands_beside_the_true_one() -> None:
    truth = SimpleNamespace(
        focal_length_mm=70.0, f_number=2.8, range_zero_mm=3.0, visits=[]
    )
    focal, cone, pupils, zero = (Uncertain(value, 0.1) for value in (70.2, 2.79, 1.0, 2.5))
    lens = Lens(focal, cone, pupils, zero)
    compared = list(compare(some_results(focus=None, wavefronts=(), lens=lens), truth))
    assert [(c.truth, c.estimate, c.std) for c in compared] == [
        (70.0, 70.2, 0.1),
        (2.8, 2.79, 0.1),
        (3.0, 2.5, 0.1),
    ]


def test_a_wavefronts_error_is_over_all_modes_and_its_worst_mode_is_named() -> None:
    w = a_wavefront(waves=np.array([0.3, 0.1, 0.02]), covariance=1e-6 * np.eye(3))
    visits = [SimpleNamespace(range_mm=3000.0, defocus_waves={"R": 0.3})]
    truth = SimpleNamespace(modes_waves={"R": {5: 0.096, 8: 0.023}}, visits=visits)
    (compared,) = compare_wavefronts(some_results(wavefronts=(w,)), truth)
    assert compared.error_rms == pytest.approx(0.005)
    (row,) = Comparison((), (compared,), Path("report.html")).wavefront_rows()
    # sqrt(0.3^2 + 0.096^2 + 0.023^2); three modes with 0.001 each
    assert row == ["wavefront R at 3000 mm", "0.3158", "0.0050", "0.0017", "+4.0 (Noll 5)"]


def test_a_new_folder_is_never_one_that_is_there(tmp_path: Path) -> None:
    assert new_folder(tmp_path / "demo") == tmp_path / "demo"
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo-2").mkdir()
    assert new_folder(tmp_path / "demo") == tmp_path / "demo-3"


def test_the_demos_end_names_commands_that_there_are() -> None:
    words = [line.split() for line in next_steps(Path("labkit-demo")).splitlines()]
    named = {line[1] for line in words if line[:1] == ["labkit"]}
    assert named == {"plan", "import", "advise", "capture"}
    assert named <= set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]


def test_the_demos_end_says_how_to_have_labkit_on_the_path_where_it_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent))
    assert "path" not in next_steps(Path("labkit-demo"))
    monkeypatch.setenv("PATH", "/nowhere")
    said = next_steps(Path("labkit-demo"))
    assert "uv tool install" in said
    assert "pipx install" in said
    assert f"source {sys.prefix}/bin/activate" in said
