"""A display's panel: its pixels, targets drawn in them, and what photographs show of them."""
