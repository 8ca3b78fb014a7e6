"""PSFs at held-out field points of a commercial lens: `python -m benchmarks.real_field FOLDER [--grid 4 5]`.

The lens is Edmund 63762 by its design (`shared/real/lens63762`), its frame reaching to 20 degrees, in three wavelengths at
23,000 electrons. A session of a grid of carpets is made in FOLDER and fitted; PSFs of the session's field model are compared
with the true ones midway between the carpets' places, where nothing was measured. PSNR: 20 log10 of the true PSF's peak over
the RMS error in WINDOW_PX pixels about the peak, both PSFs of unit sum there. FOLDER is kept: run again, only what is missing is done.

Sessions of one carpet at a field point: `python -m benchmarks.sessions OUT.jsonl --study real-lens --sessions 15`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import labkit
from benchmarks.field_sessions import TILE_PX, FieldSession, field_session, make
from benchmarks.psf_errors import least_apart, true_psf
from benchmarks.random_sessions import REAL_LENS
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.view import View
from labkit.drivers.simulated.world import TrueLens
from labkit.drivers.simulated.zernike_table import read_table
from labkit.optics.field import FieldModel
from labkit.optics.metrics import psf
from labkit.results import Results
from labkit.session.import_frames import import_frames
from labkit.types import Floats
