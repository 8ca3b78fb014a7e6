"""Predict what a plan's photographs will determine, before any is taken."""
