"""The forward model: from wavefront, pose and camera to the mean counts of a target's frame, with derivatives."""
