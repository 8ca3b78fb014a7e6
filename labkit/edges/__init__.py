"""Edges of a scene: their ranges by defocus, and the response of the camera across them."""
