"""Calibration: masters of darks and flats, gain, read noise and masks."""
