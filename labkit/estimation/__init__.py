"""The estimate: from frames to wavefronts, and from wavefronts to one lens with its errors."""
