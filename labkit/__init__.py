"""labkit measures a camera's optics from photographs of a known target."""

__version__ = "0.1.0"
