"""Photon transfer of a camera by EMVA 1288: from flats and darks of several exposures to its noise."""
