"""A session without the camera parts adopted: what the camera would give as the plan states it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from labkit.estimation.camera import Parts, most_telling
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Optimum
from labkit.estimation.refits import Refits
from labkit.estimation.select import lens_of


@dataclass(frozen=True)
class StatedCamera:
    """Refits a session with the plan's camera.

    Attributes
    ----------
    refits : refits observations
    ends : by observation, the optimum with all parts
    parts : parts and modes in the model of these optima
    adopted : the camera parts among them that the plan does not state
    """

    refits: Refits
    ends: Mapping[int, Optimum]
    parts: Parts
    adopted: Parts

    def explains(self) -> bool:
        """Return whether it explains any of the fits that show most of the adopted parts.

        If it explains none, its results tell nothing, and fits with so wrong a model take longer than all others.
        """
        shown = self._refitted(most_telling(self.ends, self.adopted))
        return any(end.verdict.accepted for end in shown.values())

    def session(self, whole: Estimate) -> Estimate:
        """Return the session of all fits, each climbed from its optimum with all parts.

        Parameters
        ----------
        whole : the session with all parts, whose fits are those of `ends`, in order
        """
        bare = self._refitted(list(self.ends))
        fits = tuple(
            replace(fit, optimum=bare.get(k, fit.optimum).nearest_to(fit.optimum))
            for k, fit in zip(self.ends, whole.fits, strict=True)
        )
        if (lens := whole.lens) is not None:
            measured = {
                whole.row(i): fits[i].optimum.candidate.measured for i in whole.members
            }
            lens = lens_of(measured, lens)
        return replace(whole, fits=fits, lens=lens)

    def _refitted(self, places: Sequence[int]) -> dict[int, Optimum]:
        ends = {k: self.ends[k] for k in places}
        return self.refits(ends, self.parts, self.parts - self.adopted, score=False)
