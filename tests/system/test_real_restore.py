"""A real photograph restored through another camera's lens: looked at, and no more ringing than another method leaves.

Skipped where the photograph is not at hand.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy import ndimage

from labkit.cli import run
from labkit.plan import Plan
from labkit.restoration.baselines import richardson_lucy
from labkit.results import Results, Wavefront
from tests.plans import plan_text
from tests.system.test_real_edges import NIKON, REAL
from tests.system.test_restore import line_of

__all__ = ["line_of"]

PHOTOGRAPH = REAL / "DSC_1339_768x512_rggb.raw"
