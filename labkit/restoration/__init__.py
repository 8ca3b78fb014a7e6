"""Scenes restored from aliased mosaics with a session's lens (thesis §4.5.3, Appendix K)."""
