"""Targets: figures of known radiance, grids of them, their files."""
