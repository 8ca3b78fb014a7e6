"""Capture: stations of the rail, exposures, focusing, and checks before and during a session."""
