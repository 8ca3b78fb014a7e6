"""A display's panel: its pixels, targets drawn in them, and what photographs show of them."""

USUAL_APERTURE = 0.85
"""Share of its third, and of the pitch along it, that a stripe is usually lit over."""
