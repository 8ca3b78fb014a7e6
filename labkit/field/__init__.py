"""A lens over the whole frame, from tiles of targets: focal surface, tilt, decentre, distortion, lateral colour."""
