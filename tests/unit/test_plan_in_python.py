"""Plans made and changed in Python: checked as files are, and written so that they read back the same."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labkit.errors import PlanError
from labkit.plan import CameraSettings, Plan
from labkit.session.session import Session
from tests.plans import PORTRAIT, SMALL, plan_text, simulated

PLAN = Plan.parse(plan_text(SMALL, simulated([2000, 2050.5], 1950.0)))


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high) | st.integers(int(low) + 1, int(high))


LINES = st.text(st.characters(categories=("L", "N", "P", "S")) | st.just(" "), min_size=1)
TABLES = {
    "lens": st.fixed_dictionaries(
        {"focal_length_mm": number(0.1, 900), "f_number": number(0.3, 256)}
    ),
    "sensor": st.fixed_dictionaries(
        {"pixel_pitch_um": number(0.1, 1000)},
        optional={
            "fill_factor": st.floats(0.001, 1),
            "black_level": number(0, 99),
            "white_level": number(100, 65535),
        },
    ),
    "channel": st.lists(
        st.fixed_dictionaries(
            {"name": st.sampled_from("RGB"), "wavelength_nm": number(100, 20_000)}
        ),
        min_size=1,
        max_size=3,
        unique_by=lambda channel: channel["name"],
    ),
    "target": st.fixed_dictionaries(
        {
            "kind": st.just("sierpinski"),
            "order": st.integers(1, 8),
            "size_mm": number(1, 1e6),
        },
        optional={
            "surround": st.sampled_from(["black", "white", "unknown"]),
            "corners_px": st.just([[0, 0.5], [0, 9], [9, 9], [9, 1e-5]]),
        },
    ),
}
DEVICES = {
    "fit": st.fixed_dictionaries(
        {}, optional={"zernike_noll": st.just([4, 22]), "range_std_mm": number(0, 1000)}
    ),
    "camera": st.fixed_dictionaries(
        {"address": st.just("gphoto2:usb:001,004"), "exposure_s": number(1e-5, 3600)}
    ),
    "rail": st.fixed_dictionaries(
        {
            "address": st.builds(
                "grbl:{}".format, LINES.map(lambda text: text.replace(" ", ""))
            ),
            "ranges_mm": st.lists(number(1000, 1e6), min_size=1, unique_by=float),
            "range_at_zero_mm": number(-1e6, 1e6),
        }
    ),
    "display": st.fixed_dictionaries({"address": st.just("simulated:"), "panel": LINES}),
}


@settings(max_examples=200)
@given(st.fixed_dictionaries(TABLES, optional=DEVICES))
def test_a_plan_reads_back_from_its_toml_the_same(tables: dict[str, Any]) -> None:
    plan = Plan.from_tables(tables)
    assert Plan.parse(plan.to_toml(), "/elsewhere") == plan


def test_a_target_file_stays_the_same_wherever_the_toml_is_put(tmp_path: Path) -> None:
    odd = tmp_path / 'a "carpet"\\ of \x7f ü\n.pgm'
    odd.write_bytes(b"P5 1 1 255\n\x80")
    plan = PLAN.replace(target={"kind": "image", "file": odd})
    assert Plan.parse(plan.to_toml(), "/elsewhere").target.file == odd


def test_a_table_is_changed_key_by_key_and_the_plan_is_not() -> None:
    changed = PLAN.replace(fit={"zernike_noll": (4, 22)}, camera={"iso": 200})
    assert changed.fit.zernike_noll == (4, 22)
    assert changed.camera == CameraSettings(address="simulated:", exposure_s=0.02, iso=200)
    assert (changed.lens, changed.rail) == (PLAN.lens, PLAN.rail)
    assert PLAN.fit.zernike_noll is None


def test_channels_take_the_place_of_all_channels() -> None:
    changed = PLAN.replace(
        channel=[{"name": "R", "wavelength_nm": 650}, {"name": "B", "wavelength_nm": 450}]
    )
    assert [channel.name for channel in changed.channel] == ["R", "B"]
    assert changed.replace(channel=PLAN.channel) == PLAN


def test_none_takes_a_key_or_a_table_out_again() -> None:
    changed = PLAN.replace(fit={"zernike_noll": (4, 22), "range_std_mm": 0.1})
    assert changed.replace(fit={"zernike_noll": None}).fit.zernike_noll is None
    assert changed.replace(fit=None, rail=None) == PLAN.replace(rail=None)


def test_numbers_of_numpy_are_numbers() -> None:
    changed = PLAN.replace(
        fit={"zernike_noll": np.array([4, 22])}, lens={"f_number": np.float32(8)}
    )
    assert (changed.fit.zernike_noll, changed.lens.f_number) == ((4, 22), 8.0)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        (
            {"fit": {"zernike_noll": (4, 99)}},
            r"^fit\.zernike_noll = \[4, 99\]: allowed is .* last <= 66$",
        ),
        (
            {"fit": {"zernike": (4, 9)}},
            r"^fit\.zernike is no known key; did you mean zernike_noll\?",
        ),
        ({"fits": {}}, "^fits is no known key; did you mean fit"),
        ({"lens": None}, "^lens is missing"),
        ({"lens": 70}, "^lens = 70: allowed is a table$"),
        ({"camera": {"iso": 2**64}}, r"^camera\.iso: an integer of more than 64 bits"),
        ({"camera": {"iso": 100.5}}, r"^camera\.iso = 100\.5: allowed is a whole number"),
        (
            {"rail": {"ranges_mm": [40]}},
            r"^rail\.ranges_mm has 40 mm: allowed is more than the focal length",
        ),
    ],
)
def test_what_a_file_may_not_say_python_may_not_say_either(
    tables: dict[str, Any], words: str
) -> None:
    with pytest.raises(PlanError, match=words) as caught:
        PLAN.replace(**tables)
    assert "\n" not in str(caught.value)


def test_a_plan_made_in_python_starts_a_session(tmp_path: Path) -> None:
    plan = Plan.from_tables({**PORTRAIT, "fit": {"zernike_noll": (4, 22)}})
    with Session.create(tmp_path / "night-3", plan.to_toml(), tmp_path) as session:
        assert session.plan == plan
