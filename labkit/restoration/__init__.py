"""Scenes restored from aliased mosaics: arrays in, arrays out (thesis §4.5.3, Appendix K)."""
