"""The catalogue of sessions: what each measured, a lens's history, and whether two sessions are of one lens."""
