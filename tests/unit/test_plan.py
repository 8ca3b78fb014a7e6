"""Plans: what is accepted, and what the messages say."""

from pathlib import Path

import numpy as np
import pytest

from labkit.errors import PlanError
from labkit.estimation.stated import optics_of
from labkit.imaging.parts import (
    Blades,
    Diffusion,
    Obstruction,
    Smear,
    SpectrumWidth,
    Veil,
)
from labkit.imaging.parts.blur import BROADEST_PX, NARROWEST_PX, SCALE_PX
from labkit.imaging.parts.rim import USUAL_SHARE
from labkit.optics.spectrum import WIDEST_SPECTRUM, Spectrum
from labkit.plan import Plan
from labkit.plan.channel import WIDEST_LIGHT
from labkit.plan.text import numbers_meant
from tests.plans import IPAD, PORTRAIT, RED_AND_GREEN, plan_text, simulated

LEAST = plan_text(PORTRAIT, RED_AND_GREEN, {"target": {"order": 5, "size_mm": 46.8}})
CAPTURE = plan_text(
    simulated([3000, 3200, 3300], 2950.0),
    {
        "display": IPAD,
        "camera": {"address": "gphoto2:usb:001,004"},
        "rail": {"address": "grbl:/dev/ttyUSB0"},
    },
)


def parse(text: str) -> Plan:
    return Plan.parse(text, "/nowhere")


def refusal(old: str, new: str, text: str = LEAST + CAPTURE) -> str:
    """The message for a plan with one thing changed; it is one line."""
    assert old in text
    with pytest.raises(PlanError) as caught:
        parse(text.replace(old, new, 1))
    message = str(caught.value)
    assert message.isprintable()
    return message


def test_the_least_plan_takes_the_documented_defaults() -> None:
    plan = parse(LEAST)
    assert [channel.name for channel in plan.channel] == ["R", "G"]
    assert plan.fit.zernike_noll is None
    assert plan.fit.noll == tuple(range(4, 16))
    assert plan.fit.mode_groups == (
        "modes_16_21",
        "modes_22_28",
        "modes_29_36",
        "modes_37_37",
    )
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
        (
            "order = 5",
            'order = 5\nsurround = "red"',
            ["target.surround = 'red'", "'black', 'white' or 'unknown'"],
        ),
        ('kind = "sierpinski"', 'kind = "image"', ["target.file is missing"]),
        (
            'kind = "sierpinski"',
            'kind = "image"\nfile = "no.pgm"',
            ["no.pgm", "no such file"],
        ),
        (
            "order = 5",
            "order = 5\ncorners_px = [[0, 0], [1, 1], [0, 1], [1, 0]]",
            ["target.corners_px", "convex"],
        ),
        (
            "order = 5",
            "order = 5\ncorners_px = [[0, 0], [0, 9], [9, 9]]",
            ["target.corners_px", "four finite corners"],
        ),
        (
            "[target]",
            "[fit]\nzernike_noll = [4, 99]\n[target]",
            ["fit.zernike_noll = [4, 99]", "last <= 66"],
        ),
        (
            "[target]",
            "[fit]\nzernike_noll = [1, 15]\n[target]",
            ["fit.zernike_noll = [1, 15]", "4 <= first"],
        ),
        ("= 4.78", '= 4.78\ncfa_pattern = "RGG"', ["sensor.cfa_pattern = 'RGG'", '"mono"']),
        ("= 4.78", '= 4.78\ncfa_pattern = "mono"', ["2 [[channel]] tables", "exactly one"]),
        ("= 4.78", '= 4.78\ncfa_pattern = "RYYB"', ['channel.name = "G"', "RYYB"]),
        (
            "= 4.78",
            "= 4.78\nblack_level = 600\nwhite_level = 255",
            ["sensor.white_level = 255", "600"],
        ),
        (
            "= 4.78",
            '= 4.78\nlow_pass_filter = {spread_px = "fitt"}',
            ["low_pass_filter.spread_px = 'fitt'", '"fit"'],
        ),
        (
            "= 4.78",
            "= 4.78\nlow_pass_filter = {spread_px = [1, 2, 3]}",
            ["spread_px = [1, 2, 3]", "0 to 3 pixels"],
        ),
        (
            "= 4.78",
            "= 4.78\nlow_pass_filter = {spread_px = -1}",
            ["spread_px = -1", "0 to 3 pixels"],
        ),
        (
            "= 550.0",
            "= 550.0\nspectrum = [[550, 0]]",
            ['"G".spectrum has no weight', "[[nm, weight], ...]"],
        ),
        (
            "= 550.0",
            "= 550.0\nspectrum = [[640, 1]]",
            ["outside the channel", "mean is 640 nm", "wavelength_nm is 550"],
        ),
        (
            "= 550.0",
            "= 550.0\nspectrum = [[550]]",
            ['"G".spectrum = [[550]]', "[[nm, weight], ...]"],
        ),
        ('name = "G"', 'name = "R"', ['channel.name = "R"', "each name once"]),
        (
            'name = "G"',
            'name = "red"',
            ['channel.name = "red": allowed is R, G or B', "did you mean R?"],
        ),
        ('name = "G"', 'name = "E"', ['channel.name = "E": allowed is R, G or B']),
        (
            "= 4.78",
            '= 4.78\ncfa_pattern = "GGRG"\n[[channel]]\nname = "GG"\nwavelength_nm = 1e3',
            ['"GG": allowed'],
        ),
        (
            "wavelength_nm = 550.0",
            "wavelength_nm = 5",
            ['channel "G".wavelength_nm = 5: allowed is a number, 100'],
        ),
        ('name = "G"', "", ["[[channel]] number 2.name is missing"]),
        ('name = "G"', "name = 7", ["channel.name = 7: allowed is"]),
        (
            "[3000, 3200, 3300]",
            "[3000, 60]",
            ["rail.ranges_mm has 60 mm", "more than the focal length, 70 mm"],
        ),
        ("[3000, 3200, 3300]", "[3000, 3000]", ["rail.ranges_mm", "3000 twice"]),
        ("[3000, 3200, 3300]", "[]", ["rail.ranges_mm = []", "one or more"]),
        ("grbl:/dev", "/dev", ["rail.address = '/dev/ttyUSB0'", "grbl:/dev/ttyUSB0"]),
        (
            'panel = "ipad-9.7-retina"',
            "pixel_pitch_mm = 0.1",
            ["display.pixel_pitch_mm and pixels"],
        ),
        (
            "[3000, 3200, 3300]",
            '[3000, "far"]',
            ["rail.ranges_mm = [3000, 'far']: allowed is one or more ranges in mm"],
        ),
        (
            'panel = "ipad-9.7-retina"',
            'panel = "\\u001b[2J"',
            ["display.panel = '\\x1b[2J': allowed is printable"],
        ),
        ("= 2950.0", "= 2950.0\ndirection = 0", ["rail.direction = 0", "1 or -1"]),
    ],
)
def test_a_wrong_field_is_named_with_its_value_and_what_is_allowed(
    old: str, new: str, words: list[str]
) -> None:
    message = refusal(old, new)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("spread", "squares"),
    [("0.7", (0.49, 0.49)), ("[0.5, 0.6]", (0.25, 0.36)), ('"fit"', (0.25, 0.25))],
)
def test_a_low_pass_filter_is_stated_or_to_be_fitted(
    spread: str, squares: tuple[float, float]
) -> None:
    text = LEAST.replace("= 4.78", f"= 4.78\nlow_pass_filter = {{spread_px = {spread}}}")
    plan = Plan.parse(text)
    assert plan.sensor.low_pass_filter is not None
    assert plan.sensor.low_pass_filter.squares == pytest.approx(squares)
    optics = optics_of(plan, "G")
    fitted, given = (
        (optics.parts, optics.given) if spread == '"fit"' else (optics.given, optics.parts)
    )
    assert fitted[0].values == pytest.approx(squares)
    assert given == ()
    assert Plan.parse(plan.to_toml()) == plan


def test_a_spectrum_stands_for_the_channels_light() -> None:
    plan = Plan.parse(
        LEAST.replace("= 550.0", "= 550.0\nspectrum = [[530, 1], [550, 2], [580, 1]]")
    )
    spectrum = optics_of(plan, "G").light
    assert np.dot(spectrum.weights, spectrum.nodes) == pytest.approx(552.5 / 550)
    assert optics_of(plan, "R").light.nodes == (1.0,)
    assert Plan.parse(plan.to_toml()) == plan


def test_parts_of_the_camera_are_stated_or_to_be_fitted() -> None:
    text = LEAST.replace("= 4.78", "= 4.78\ndiffusion_px = {0}\nsmear_px = {0}").replace(
        "= 2.8", "= 2.8\nveil = {0}"
    )
    stated, wanted = (
        optics_of(Plan.parse(text.format(number)), "G") for number in ("0.2", '"fit"')
    )
    assert stated.given == (Diffusion(0.2**2), Veil(0.2), Smear(0.2**2, 0.2**2))
    assert stated.parts == ()
    assert wanted.given == ()
    assert wanted.parts == (Diffusion(), Veil(), Smear())
    assert "smear_px = 4" in refusal("= 4.78", "= 4.78\nsmear_px = 4")


def test_a_rim_is_stated_or_to_be_fitted() -> None:
    plan = Plan.parse(LEAST.replace("= 2.8", "= 2.8\nblades = 7\nobstruction = 0.38"))
    optics = optics_of(plan, "G")
    assert optics.given == (Obstruction(0.38**2),)
    assert optics.parts == (Blades(7),)  # turn and roundness are always fitted
    assert Plan.parse(plan.to_toml()) == plan
    wanted = Plan.parse(LEAST.replace("= 2.8", '= 2.8\nobstruction = "fit"'))
    assert optics_of(wanted, "G").parts == (Obstruction(USUAL_SHARE),)


@pytest.mark.parametrize("blades", ["2", "21", "7.5", '"fit"'])
def test_a_diaphragm_has_three_to_twenty_blades(blades: str) -> None:
    told = refusal("= 2.8", f"= 2.8\nblades = {blades}")
    assert "lens.blades" in told
    assert "a whole number" in told
    assert "\n" not in told.strip()


@pytest.mark.parametrize("diameter", ["0.9", "1", "-0.1", "'some'"])
def test_an_obstruction_leaves_a_pupil(diameter: str) -> None:
    told = refusal("= 2.8", f"= 2.8\nobstruction = {diameter}")
    assert f"lens.obstruction = {diameter}" in told
    assert '0 to 0.89, or "fit"' in told
    assert "\n" not in told.strip()


def test_a_veil_has_a_scale() -> None:
    near = Plan.parse(LEAST.replace("= 2.8", "= 2.8\nveil = 0.03\nveil_scale_px = 8"))
    assert optics_of(near, "G").given == (Veil(0.03, 8.0),)
    assert Plan.parse(near.to_toml()) == near
    for scale in (NARROWEST_PX, SCALE_PX, BROADEST_PX):  # of a plan and of a fit
        assert (
            Plan.parse(
                LEAST.replace("= 2.8", f"= 2.8\nveil_scale_px = {scale}")
            ).lens.veil_scale_px
            == scale
        )
    assert Plan.parse(LEAST).lens.veil_scale_px == SCALE_PX
    assert "allowed is a number, 3 to 100" in refusal(
        "= 2.8", f"= 2.8\nveil_scale_px = {1.01 * BROADEST_PX}"
    )


def test_a_width_stands_for_a_spectrum() -> None:
    stated, wanted = (
        optics_of(Plan.parse(LEAST.replace("= 550.0", f"= 550.0\nwidth_nm = {width}")), "G")
        for width in ("11", '"fit"')
    )
    nodes, weights = np.array(stated.light.nodes), np.array(stated.light.weights)
    assert 550 * np.sqrt(weights @ (nodes - 1) ** 2) == pytest.approx(11)
    assert stated.parts == ()  # not estimated
    assert wanted.parts == (SpectrumWidth(),)
    assert "allowed is up to 8% of the wavelength, 44 nm" in refusal(
        "= 550.0", "= 550.0\nwidth_nm = 60"
    )
    assert "allowed is one of them" in refusal(
        "= 550.0", "= 550.0\nwidth_nm = 6\nspectrum = [[550, 1]]"
    )
    assert WIDEST_LIGHT == WIDEST_SPECTRUM  # of a plan and of a fit


@pytest.mark.parametrize("stated", ["width_nm = 0", "spectrum = [[550, 1]]"])
def test_one_wavelength_may_be_stated(stated: str) -> None:
    plan = Plan.parse(LEAST.replace("= 550.0", f"= 550.0\n{stated}"))
    optics = optics_of(plan, "G")
    assert optics.light == Spectrum()
    assert SpectrumWidth.name not in optics.lacking  # photographs are not asked for another
    assert SpectrumWidth.name in optics_of(Plan.parse(LEAST), "G").lacking


def test_a_channels_own_problem_is_the_only_one_named() -> None:
    message = refusal("= 550.0", "= 550.0\nspectrum = [[540, 0], [560, 0]]")
    assert message.endswith("with weights from 0, some above")


def test_every_problem_is_named_at_once() -> None:
    message = refusal("f_number = 2.8", "f_number = 0", LEAST.replace("4.78", "-1"))
    assert "lens.f_number" in message
    assert "sensor.pixel_pitch_um" in message


def test_a_file_that_is_no_toml_says_where() -> None:
    assert "line" in refusal("[target]", "[target")


def test_a_target_file_is_relative_to_the_plan(tmp_path: Path) -> None:
    (tmp_path / "pattern.pgm").write_bytes(b"P5 1 1 255\n\x80")
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(LEAST.replace('"sierpinski"', '"image"\nfile = "pattern.pgm"'))
    assert Plan.load(plan_path).target.file == tmp_path / "pattern.pgm"


def test_a_missing_plan_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"absent\.toml: No such file"):
        Plan.load(tmp_path / "absent.toml")


def test_what_is_wrong_in_the_only_channel_is_said_once() -> None:
    with pytest.raises(
        PlanError,
        match=r'^channel "G"\.wavelength_nm = 0\.55: allowed is a number, 100 to 20000$',
    ):
        parse(
            "[lens]\nfocal_length_mm = 50\nf_number = 2\n[sensor]\npixel_pitch_um = 4\n[[channel]]\nname = 'G'\n"
            "wavelength_nm = 0.55\n[target]\nkind = 'sierpinski'\norder = 3\nsize_mm = 10\n"
        )


def test_a_folder_in_the_place_of_a_plan_is_answered_with_its_plan(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").touch()
    with pytest.raises(
        PlanError, match=rf"{tmp_path}: is a folder: give {tmp_path}/plan\.toml$"
    ):
        Plan.load(tmp_path)


@pytest.mark.parametrize("names", ["R", "G", "mono", "L"])
def test_a_lone_channel_is_a_colour_or_that_of_a_mono_sensor(names: str) -> None:
    assert Plan.parse(
        plan_text(PORTRAIT, {"channel": [{"name": names, "wavelength_nm": 550.0}]})
    ).channel


@pytest.mark.parametrize("name", ["red", "r", "Green", "blue"])
def test_a_lone_channel_named_like_a_colour_is_refused_unless_the_sensor_is_mono(
    name: str,
) -> None:
    channel = {"channel": [{"name": name, "wavelength_nm": 550.0}]}
    with pytest.raises(PlanError, match=f"did you mean {name[0].upper()}"):
        Plan.parse(plan_text(PORTRAIT, channel))
    assert (
        Plan.parse(plan_text(PORTRAIT, channel, {"sensor": {"cfa_pattern": "mono"}}))
        .channel[0]
        .name
        == name
    )


def test_one_pair_of_brackets_too_few_is_what_the_message_says() -> None:
    one = plan_text(PORTRAIT).replace("[[channel]]", "[channel]")
    with pytest.raises(
        PlanError,
        match=r"write \[\[channel\]\], with double brackets, once for each channel$",
    ):
        Plan.parse(one)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "f_number = 2.8",
            "f_number = f/2.8",
            ["line 3", "f_number = f/2.8", "; write 2.8"],
        ),
        (
            "f_number = 2.8",
            'f_number = "f/2.8"',
            ["lens.f_number = 'f/2.8': allowed is a number", "; write 2.8"],
        ),
        ("f_number = 2.8", "f_number = 2,8", ["f_number = 2,8", "; write 2.8"]),
        (
            "exposure_s = 0.02",
            "exposure_s = 1/50  # s",
            ["exposure_s = 1/50", "; write 0.02"],
        ),
        (
            "exposure_s = 0.02",
            'exposure_s = "1/50"',
            ["camera.exposure_s = '1/50': allowed is", "; write 0.02"],
        ),
    ],
)
def test_numbers_as_engraved_are_given_as_they_should_be_written(
    old: str, new: str, words: list[str]
) -> None:
    message = refusal(old, new)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("new", "words"),
    [
        (f"f_number = {'9' * 5000}", "not TOML: an integer of more than 64 bits"),
        (f"f_number = 0x{'f' * 5000}", "lens.f_number: an integer of more than 64 bits"),
        (f"f_number = {'[' * 20000}", "too deep in one another"),
        (
            f"f_number = {'[' * 30}{']' * 30}",
            "lens.f_number: lists or tables more than 6 deep",
        ),
        (f"f_number{'.a' * 9} = 1", "lens.f_number: lists or tables more than 6 deep"),
        (f"f_number{'.a' * 20000} = 1", "too deep in one another"),
        (f"f_number = '{'a' * 100_000}'", "'aaa"),
        ('"\\u001b[31m" = 1', r"lens.\x1b[31m is no known key"),
        ("\0", "not TOML"),
    ],
    ids=lambda value: value[:20],
)
def test_no_number_no_depth_and_no_letter_ends_in_more_than_a_short_printable_line(
    new: str, words: str
) -> None:
    message = refusal("f_number = 2.8", new)
    assert words in message
    assert len(message) < 300


def test_a_byte_order_mark_is_no_part_of_the_plan(tmp_path: Path) -> None:
    plan_path = tmp_path / "plan.toml"
    plan_path.write_text(LEAST, encoding="utf-8-sig")
    assert Plan.load(plan_path) == Plan.parse("\ufeff" + LEAST) == parse(LEAST)


def test_a_plan_that_is_no_text_says_where(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_bytes(b"[lens]\n\xff")
    with pytest.raises(PlanError, match=r"plan\.toml: not UTF-8 at byte 7"):
        Plan.load(tmp_path / "plan.toml")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("1,500", ("1.500", "1500")),
        ("1.500,0", ("1500.0",)),
        ("1,500.0", ("1500.0",)),
        ("1 500", ("1500",)),
        ("1\u00a0500", ("1500",)),
        ("1\u202f500,25", ("1500.25",)),
        ("1'500", ("1500",)),
        ("1\u2019500.5", ("1500.5",)),
        ("1,500,000", ("1500000",)),
        ("1,50,000", ("150000",)),
        ("1,5", ("1.5",)),
        ("0,500", ("0.500",)),
        ("\uff11\uff15\uff10\uff10", ("1500",)),
        ("\uff11\uff0c\uff15", ("1.5",)),
        ("\u0661\u066c\u0665\u0660\u0660", ("1.500", "1500")),
        ("1500 mm", ("1500",)),
        ("1,5 m", ("1500",)),
        ("150cm", ("1500",)),
        ('10"', ("254",)),
        ("1/50", ("0.02",)),
        ("f/2,8", ("2.8",)),
        ("2026.11.29", ()),
        ("1..5", ()),
        ("1500 s", ()),
        ("about 3", ()),
        ("9" * 5000, ()),
    ],
)
def test_a_number_in_the_notation_of_any_country_is_understood(
    written: str, meant: tuple[str, ...]
) -> None:
    assert numbers_meant(written, "mm") == meant
