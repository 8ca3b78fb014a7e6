"""A lens over the whole frame, from photographs of charts with straight edges: checkerboards, slanted squares."""
