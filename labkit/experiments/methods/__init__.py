"""Methods of the thesis that only `study` needs: warps, sampling, bounds, tests of an optimum."""
