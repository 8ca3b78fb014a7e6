"""The target in a photograph: found, its corners measured, its sharpness judged."""
