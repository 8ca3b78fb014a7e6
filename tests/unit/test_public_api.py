"""What `import labkit` offers: these names, each with a line of use, and nothing that takes time."""

import subprocess
import sys

import pytest

import labkit

NAMES = {
    "LabkitError",
    "Optics",
    "Plan",
    "Results",
    "Session",
    "Uncertain",
    "Wavefront",
    "__version__",
    "advise",
    "capture",
    "fit",
    "fit_image",
    "import_frames",
    "open_devices",
    "open_target",
    "write_report",
}


def test_the_public_names_are_these() -> None:
    assert set(labkit.__all__) == NAMES
    assert set(dir(labkit)) >= NAMES


@pytest.mark.parametrize("name", sorted(NAMES - {"__version__"}))
def test_every_public_name_shows_a_line_of_use(name: str) -> None:
    assert ">>> " in (getattr(labkit, name).__doc__ or "")


def test_another_name_is_an_error_that_names_it() -> None:
    with pytest.raises(AttributeError, match="'labkit' has no attribute 'fits'"):
        labkit.fits  # noqa: B018


def test_importing_labkit_loads_nothing_heavy() -> None:
    heavy = "import sys, labkit; print(sorted({'numpy', 'scipy', 'cv2', 'rawpy', 'matplotlib'} & set(sys.modules)))"
    assert (
        subprocess.run(
            [sys.executable, "-c", heavy], capture_output=True, text=True, timeout=60
        ).stdout
        == "[]\n"
    )


@pytest.mark.slow
def test_a_room_of_the_same_name_hides_no_function() -> None:
    # importing a submodule binds its name in the package: no room may be called as a function is
    loaded = "import labkit.cli, labkit.demo, labkit; print(all(callable(getattr(labkit, n)) for n in {names}))"
    program = loaded.format(names=sorted(NAMES - {"__version__"}))
    assert (
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
        ).stdout
        == "True\n"
    )
