"""Optics of a wavefront: modes, pupil, PSF, MTF, Strehl ratio, focus, each with standard errors."""
