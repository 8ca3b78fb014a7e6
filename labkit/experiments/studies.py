"""The studies by name."""

STUDIES = {
    "crb": "accuracy",
    "global": "search",
    "minima": "minima",
    "annealing": "annealing",
    "psf-accuracy": "pupil_size",
    "roc": "roc",
    "uniform-crb": "uniform_crb",
    "targets": "targets",
    "extension": "extension",
    "edges": "edge_ranging",
    "restoration": "restoration",
}
"""Name of a study -> the module of this room that does it, by its function `run`."""
