"""Names of the parameters of a fit, in the order of its information matrix."""

from collections.abc import Sequence

from labkit.estimation.climb import State
from labkit.imaging.warp import POSE_SIZE
from labkit.optics.zernike import mode_name

OF_A_FRAME = (*(f"pose {i}" for i in range(POSE_SIZE)), "scale", "ambient light")


def parameter_names(state: State, noll: Sequence[int]) -> tuple[str, ...]:
    """Name all parameters of a state, in the order of `State.moved`.

    Parameters
    ----------
    state : point at which the information is evaluated
    noll : Noll's numbers of the modes

    Returns
    -------
    one name for each row of the information matrix
    """
    modes = [mode_name(j) for j in noll]
    frames = [
        f"{name} of frame {k + 1}" for k in range(len(state.poses)) for name in OF_A_FRAME
    ]
    light = [f"unevenness {k + 1}" for k in range(state.unevenness.size)]
    return (*modes, *frames, *light, "log gain", "log read variance")
