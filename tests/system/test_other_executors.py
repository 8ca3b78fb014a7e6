"""The guide's script for MPI, as it stands there, gives the numbers of a fit in one process."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from labkit.analysis.fit import fit
from labkit.results import Results

pytestmark = pytest.mark.slow

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "sessions.md"
BIN = Path(sys.executable).parent


def mpiexec() -> str:
    """Return the program that starts MPI processes; skip the test without it."""
    program = shutil.which("mpiexec", path=BIN) or shutil.which("mpiexec")
    if program is None or find_spec("mpi4py") is None:
        pytest.skip("MPI is not installed: pip install mpi4py mpich")
    return program


def test_the_script_for_mpi_gives_the_numbers_of_one_process(
    captured: Path, tmp_path: Path
) -> None:
    program = mpiexec()
    (script,) = re.findall(r"```python\n(# mpiexec.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "fit_by_mpi.py").write_text(script)
    for night in ("night-1", "night-2"):
        shutil.copytree(captured, tmp_path / night)
    processes = [sys.executable, "-m", "mpi4py.futures", "fit_by_mpi.py"]
    subprocess.run([program, "-n", "3", *processes], cwd=tmp_path, check=True, timeout=300)
    shutil.copytree(captured, tmp_path / "alone")
    alone = fit(tmp_path / "alone", workers=1)
    for night in ("night-1", "night-2"):
        by_mpi = Results.load(tmp_path / night)
        assert [one.waves.tolist() for one in by_mpi] == [
            one.waves.tolist() for one in alone
        ]
