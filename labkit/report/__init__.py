"""The report of results: a page, its tables and figures, and files of numbers."""
