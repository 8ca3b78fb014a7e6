"""Files: written whole, read within limits, decoded apart."""
