"""Protocols of cameras, rails and displays; drivers plug in by address."""
