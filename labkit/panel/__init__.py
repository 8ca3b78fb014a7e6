"""A display's own pixels: how a target looks in them, and whether photographs show them."""
