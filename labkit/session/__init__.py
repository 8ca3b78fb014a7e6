"""Session folders: frames, journal and plan."""
