"""Plans: what is accepted, and what the messages say."""

from pathlib import Path

import pytest

from labkit.errors import PlanError
from labkit.plan import Plan, load_plan, parse_plan

LEAST = """
[lens]
focal_length_mm = 70.0
f_number = 2.8

[sensor]
pixel_pitch_um = 4.78

[[channel]]
name = "R"
wavelength_nm = 650.0

[[channel]]
name = "G"
wavelength_nm = 550.0

[target]
kind = "sierpinski"
order = 5
size_mm = 46.8
"""

CAPTURE = """
[camera]
address = "gphoto2:usb:001,004"
exposure_s = 0.02

[rail]
address = "grbl:/dev/ttyUSB0"
ranges_mm = [3000, 3200, 3300]
range_at_zero_mm = 2950.0

[display]
address = "web://0.0.0.0:8642"
panel = "ipad-9.7-retina"
"""


def parse(text: str) -> Plan:
    return parse_plan(text, Path("/nowhere"))


def refusal(old: str, new: str, text: str = LEAST + CAPTURE) -> str:
    """The message for a plan with one thing changed; it is one line."""
    assert old in text
    with pytest.raises(PlanError) as caught:
        parse(text.replace(old, new, 1))
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_least_plan_takes_the_documented_defaults() -> None:
    plan = parse(LEAST)
    assert [channel.name for channel in plan.channel] == ["R", "G"]
    assert plan.fit.zernike_noll == (4, 15)
    assert plan.fit.convention == "corrected"
    assert plan.reference_wavelength_nm == 450.0
    assert (plan.sensor.fill_factor, plan.target.surround) == (1.0, "black")
    assert (plan.camera, plan.rail, plan.display) == (None, None, None)


def test_a_capture_plan_keeps_addresses_and_ranges() -> None:
    plan = parse(LEAST + CAPTURE)
    assert plan.rail is not None
    assert plan.camera is not None
    assert plan.rail.ranges_mm == (3000.0, 3200.0, 3300.0)
    assert plan.camera.address == "gphoto2:usb:001,004"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("f_number = 2.8", "f_number = -1", ["lens.f_number = -1", "0.3 to 256"]),
        ("f_number = 2.8", 'f_number = "wide"', ["lens.f_number = 'wide'", "0.3 to 256"]),
        ("f_number = 2.8", "f_number = nan", ["lens.f_number = nan", "0.3 to 256"]),
        ("f_number = 2.8", "", ["lens.f_number is missing", "0.3 to 256"]),
        ("f_number = 2.8", "f_numbr = 2.8", ["lens.f_numbr is no known key", "f_number?"]),
        ("[lens]", "[lense]", ["lense is no known key", "did you mean lens?"]),
        ("order = 5", "order = 5.5", ["target.order = 5.5", "whole number, 1 to 8"]),
        ("order = 5", "", ["target.order is missing", "sierpinski"]),
        ("order = 5", 'order = 5\nsurround = "red"', ["target.surround = 'red'", "'black', 'white' or 'unknown'"]),
        ('kind = "sierpinski"', 'kind = "image"', ["target.file is missing"]),
        ('kind = "sierpinski"', 'kind = "image"\nfile = "no.pgm"', ["no.pgm", "no such file"]),
        ("order = 5", "order = 5\ncorners_px = [[0, 0], [1, 1], [0, 1], [1, 0]]", ["target.corners_px", "convex"]),
        ("order = 5", "order = 5\ncorners_px = [[0, 0], [0, 9], [9, 9]]", ["target.corners_px", "four finite corners"]),
        ("[target]", "[fit]\nzernike_noll = [4, 99]\n[target]", ["fit.zernike_noll = [4, 99]", "last <= 66"]),
        ("[target]", "[fit]\nzernike_noll = [1, 15]\n[target]", ["fit.zernike_noll = [1, 15]", "4 <= first"]),
        ("= 4.78", '= 4.78\ncfa_pattern = "RGG"', ["sensor.cfa_pattern = 'RGG'", '"mono"']),
        ("= 4.78", '= 4.78\ncfa_pattern = "mono"', ["2 [[channel]] tables", "exactly one"]),
        ("= 4.78", '= 4.78\ncfa_pattern = "RYYB"', ['channel.name = "G"', "RYYB"]),
        ("= 4.78", "= 4.78\nblack_level = 600\nwhite_level = 255", ["sensor.white_level = 255", "600"]),
        ('name = "G"', 'name = "R"', ['channel.name = "R"', "each name once"]),
        ("[3000, 3200, 3300]", "[3000, 60]", ["rail.ranges_mm has 60 mm", "more than the focal length, 70 mm"]),
        ("[3000, 3200, 3300]", "[3000, 3000]", ["rail.ranges_mm", "3000 twice"]),
        ("[3000, 3200, 3300]", "[]", ["rail.ranges_mm = []", "one or more"]),
        ("grbl:/dev", "/dev", ["rail.address = '/dev/ttyUSB0'", "grbl:/dev/ttyUSB0"]),
        ('panel = "ipad-9.7-retina"', "pixel_pitch_mm = 0.1", ["display.pixel_pitch_mm and pixels"]),
        ("= 2950.0", "= 2950.0\ndirection = 0", ["rail.direction = 0", "1 or -1"]),
    ],
)
def test_a_wrong_field_is_named_with_its_value_and_what_is_allowed(old: str, new: str, words: list[str]) -> None:
    message = refusal(old, new)
    for word in words:
        assert word in message


def test_every_problem_is_told_at_once() -> None:
    message = refusal("f_number = 2.8", "f_number = 0", LEAST.replace("4.78", "-1"))
    assert "lens.f_number" in message
    assert "sensor.pixel_pitch_um" in message


def test_a_file_that_is_no_toml_says_where() -> None:
    assert "line" in refusal("[target]", "[target")


def test_a_target_file_is_relative_to_the_plan(tmp_path: Path) -> None:
    (tmp_path / "pattern.pgm").write_bytes(b"P5 1 1 255\n\x80")
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(LEAST.replace('"sierpinski"', '"image"\nfile = "pattern.pgm"'))
    assert load_plan(plan_path).target.file == tmp_path / "pattern.pgm"


def test_a_missing_plan_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"absent\.toml: No such file"):
        load_plan(tmp_path / "absent.toml")
