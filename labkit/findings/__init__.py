"""Findings: what a session shows besides its numbers, and what to do."""
