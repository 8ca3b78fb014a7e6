"""A display's own pixels: targets drawn in pixels, and pixels detected in photographs."""
