"""Methods of the thesis that no command but `study` needs: warps, sampling, bounds, tests of an optimum."""
