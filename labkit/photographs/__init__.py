"""Photographs: files decoded to counts, with levels, colours and tone curve; nothing is demosaiced."""
