"""Photographs restored with a session's lens: from files to files."""
