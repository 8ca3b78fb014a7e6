"""What `import labkit` offers: these names, each with a line of use, and nothing that takes time."""

import inspect
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

import labkit
from labkit.cli.app import app
from labkit.cli.command_line import load_commands
from labkit.session.session import Session
from tests.results_samples import PLAN

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
    "calibrate_rail",
    "camera_settings",
    "capture",
    "check_camera",
    "compare_sessions",
    "draft_plan",
    "fit",
    "fit_image",
    "import_frames",
    "lens_history",
    "list_connected",
    "list_sessions",
    "measure_chart",
    "check_screw_move",
    "split_fields",
    "summarise_field",
    "measure_edges",
    "measure_noise",
    "measure_tone",
    "open_devices",
    "open_target",
    "rebuild_catalogue",
    "render_target",
    "reprocess",
    "restore",
    "run_demo",
    "run_study",
    "serve_target",
    "verify",
    "watch_focus",
    "write_report",
}


def test_the_public_names_are_these() -> None:
    assert set(labkit.__all__) == NAMES
    assert set(dir(labkit)) >= NAMES


@pytest.mark.parametrize("name", sorted(NAMES - {"__version__"}))
def test_every_public_name_shows_a_line_of_use(name: str) -> None:
    assert ">>> " in (getattr(labkit, name).__doc__ or "")


COMMANDS = {
    "advise": "advise",
    "camera focus": "watch_focus",
    "camera settings": "camera_settings",
    "camera test": "check_camera",
    "camera tone": "measure_tone",
    "capture": "capture",
    "catalogue rebuild": "rebuild_catalogue",
    "compare": "compare_sessions",
    "demo": "run_demo",
    "devices": "list_connected",
    "chart": "measure_chart",
    "edges": "measure_edges",
    "field check-move": "check_screw_move",
    "field show": "summarise_field",
    "field split": "split_fields",
    "fit": "fit",
    "history": "lens_history",
    "noise": "measure_noise",
    "import": "import_frames",
    "list": "list_sessions",
    "plan": "draft_plan",
    "rail calibrate": "calibrate_rail",
    "report": "write_report",
    "reprocess": "reprocess",
    "restore": "restore",
    "study": "run_study",
    "target render": "render_target",
    "target serve": "serve_target",
    "verify": "verify",
}
"""The public function that does what each command does."""


def commands(group: TyperGroup, before: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        if isinstance(command, TyperGroup):
            yield from commands(command, f"{before}{name} ")
        else:
            yield before + name


def test_what_a_command_does_a_script_can_do() -> None:
    load_commands()
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    assert set(commands(group)) == set(COMMANDS)
    assert set(COMMANDS.values()) <= NAMES


@pytest.mark.parametrize("name", sorted(set(COMMANDS.values())))
def test_a_public_function_takes_no_array_method_and_no_process_limit(name: str) -> None:
    switches = {"method", "baseline", "tile_px", "solver", "optimizer", "wanted"}
    assert switches.isdisjoint(inspect.signature(getattr(labkit, name)).parameters)


def test_a_session_is_verified_by_its_path(tmp_path: Path) -> None:
    Session.create(tmp_path / "night", PLAN.to_toml(), tmp_path).close()
    assert labkit.verify(tmp_path / "night") == []
    plan = tmp_path / "night" / "plan.toml"
    plan.write_text(plan.read_text() + "\n")
    (problem,) = labkit.verify(str(tmp_path / "night"))
    assert "plan.toml" in problem


def test_a_target_is_rendered_from_its_name(tmp_path: Path) -> None:
    made = labkit.render_target(
        "sierpinski:order=2,size_mm=9", str(tmp_path / "a.png"), pixels=27
    )
    assert made.pixels == (27, 27)


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
