"""The report's part on the field: maps, profiles, tiles and tables."""
