"""A turned screw and a turned lens on the simulated bench, fitted and compared by the commands of the field.

`python -m benchmarks.turned_fields FOLDER` makes and fits three sessions of 2 × 3 carpets at two ranges: as the camera
is, with a screw turned, and with the lens turned by 180 degrees. It prints what `labkit field check-move` and `labkit
field split` say of them, with the truth. Sessions that are there already are not made again.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import labkit
from benchmarks.field_sessions import LENS, MISALIGNED, field_session, make
from labkit.types import Floats

SCREWS_MM = [[0.0, 30.0], [26.0, -15.0], [-26.0, -15.0]]
SCREW_PITCH_MM = 0.5
TURN_DEG = 60.0
"""Of the first screw, clockwise: 83 µm away from the lens, 45 mm from the line through both others."""

MOVED = np.array([1e3 * SCREW_PITCH_MM * TURN_DEG / 360 / 45, 0.0])
BODY, OF_LENS = np.array([1.5, -1.0]), np.array([0.9, -0.5])
"""Tilt of the body and of the lens, µm/mm, down and right."""

MODES = {5: 0.02, 6: -0.01, 7: 0.0, 8: 0.0, 9: 0.02, 10: -0.01, 11: 0.03}
ODD = (7, 8, 9, 10)
CARPETS = (1180.0, 1260.0), 144, 3
"""Ranges in mm, pixels of a tile, and order of the carpets: a session is fitted in half a minute of one core."""


@dataclass(frozen=True)
class State:
    """The camera at one session: a name, the seed of aim and noise, the tilt, and +1 or -1 for the lens turned by 180°."""

    name: str
    seed: int
    tilt: Floats
    sign: int = 1


STATES = (
    State("before", 11, BODY + OF_LENS),
    State("screw", 12, BODY + OF_LENS + MOVED),
    State("turned", 13, BODY - OF_LENS, -1),
)


def fitted(state: State, folder: Path) -> labkit.Results:
    """Make, import and fit the session of a state; return its results."""
    session = folder / f"session-{state.name}"
    if not session.exists():
        shots = folder / state.name
        _make(state, shots)
        labkit.import_frames(shots / "frames.csv", shots / "plan.toml", session)
    if not (session / "results/latest/results.json").exists():
        labkit.fit(session)
    return labkit.Results.load(session)


def _make(state: State, shots: Path) -> None:
    """Write the photographs of a state, and a plan with the screws."""
    sign, (ranges_mm, tile_px, order) = state.sign, CARPETS
    down, right = state.tilt.tolist()
    (coma_down, coma_right), linear = MISALIGNED.coma_waves, MISALIGNED.astigmatism_per_mm
    terms = replace(
        MISALIGNED,
        sensor_tilt_um_per_mm=(down, right),
        coma_waves=(sign * coma_down, sign * coma_right),
        astigmatism_per_mm=(sign * linear[0], sign * linear[1]),
    )
    modes = {j: sign * a if j in ODD else a for j, a in MODES.items()}
    lens = replace(LENS, aberration_waves=0.0, stated_waves=modes, field_terms=terms)
    make(
        field_session(
            (2, 3), ranges_mm, lens, seed=state.seed, tile_px=tile_px, order=order
        ),
        shots,
    )
    with (shots / "plan.toml").open("a", encoding="utf-8") as plan:
        plan.write(
            f"\n[mount]\nscrews_mm = {SCREWS_MM}\nscrew_pitch_mm = {SCREW_PITCH_MM}\n"
        )


def main() -> None:
    """Print what the commands say, and the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    before, screw, turned = (fitted(state, folder) for state in STATES)
    move = labkit.check_screw_move(before, screw, 1, TURN_DEG)
    print(f"change of tilt {move.measured.down}, {move.measured.right}; truth {MOVED}")
    print(move.words)
    truths = {
        "sensor_tilt": (BODY, OF_LENS),
        "coma": (np.zeros(2), np.array(MISALIGNED.coma_waves)),
        "linear_astigmatism": (np.zeros(2), np.array(MISALIGNED.astigmatism_per_mm)),
    }
    for name, part in labkit.split_fields([before, turned], [0, 180]).items():
        for of, pair, truth in zip(
            ("body", "lens"), (part.body, part.lens), truths[name], strict=True
        ):
            print(f"{name}, {of}: {pair.down}, {pair.right}; truth {truth}")


if __name__ == "__main__":
    main()
