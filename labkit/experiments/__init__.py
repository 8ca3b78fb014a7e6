"""Experiments of the thesis, repeated: `labkit study`."""
