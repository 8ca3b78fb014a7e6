"""The filters of the body that took a session's photographs."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.photographs.container import Container
from labkit.plan import Plan
from labkit.session.completed_plan import with_body_filters
from labkit.session.session import Session
from labkit.spectra import TYPICAL, channel_light
from tests.conftest import WriteDng
from tests.plans import PORTRAIT
from tests.unit.test_import_frames import Folder

LIT = Plan.from_tables(
    {
        **PORTRAIT,
        "channel": [
            {"name": "R", "light": "led", "wavelength_nm": 600.0},
            {"name": "G", "light": "led"},
        ],
    }
)


@pytest.fixture
def session(tmp_path_factory: pytest.TempPathFactory, write_dng: WriteDng) -> Session:
    return Folder(tmp_path_factory.mktemp("import"), write_dng).run()


def taken_with(camera: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "labkit.session.completed_plan.recognise", lambda _: Container("raw", camera)
    )


def test_exif_picks_the_filters_of_a_body_in_the_table(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken_with("NIKON CORPORATION NIKON D700", monkeypatch)
    plan = with_body_filters(session, LIT)
    assert plan.sensor.filters == "Nikon D700"
    red, green = plan.channel
    assert red.wavelength_nm == 600.0  # as it was stated
    light = channel_light("led", "Nikon D700", "G")
    assert green.stated_wavelength.value == pytest.approx(light.mean.value, abs=0.05)
    assert green.stated_wavelength.std == pytest.approx(light.mean.std, abs=0.05)
    named = plan.named_light("G")
    assert named is not None
    np.testing.assert_array_equal(named.weights, light.weights)


def test_a_body_that_the_table_lacks_has_typical_filters(session: Session) -> None:
    assert with_body_filters(session, LIT).sensor.filters == TYPICAL


def test_a_plan_that_states_its_filters_or_names_no_light_stays(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken_with("NIKON CORPORATION NIKON D700", monkeypatch)
    stated = LIT.replace(sensor={"filters": "Nikon D70"})
    assert with_body_filters(session, stated) == stated
    silent = Plan.from_tables(PORTRAIT)
    assert with_body_filters(session, silent) == silent
