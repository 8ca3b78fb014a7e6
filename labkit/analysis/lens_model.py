"""What a session's fits have in common: one lens, one sensor at rest, one rail (thesis §4.5.2, Appendix E).

Every fit measures modes, the cone's f-number and the picture's scale. All follow from a few numbers that hold for the whole
session, some of which a plan states with an error: a measurement like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from scipy.special import chdtrc

from labkit.imaging.model import SPECTRUM_WIDTH
from labkit.inference.cone import Measured
from labkit.optics.lens import Convention, ThinLens, defocus_waves
from labkit.plan import Plan
from labkit.types import Floats
from labkit.uncertain import Uncertain

USUAL_LOG_MAGNIFICATION = 0.7  # standard error: pupil magnifications of lenses lie between 0.5 and 2
SIZE_FLOOR = 3e-5  # of a size in the picture: a target is as flat, a picture as free of distortion
SAME_LEAN = 1e-3  # chance of leans that differ as much, below which they are not the same
LEAN_FLOOR = 1e-5  # of a size, by which a carriage that tips changes it
FREE_CONE, FREE_SIZE = 0.1, 0.03  # relative errors of cone and scale where no law holds
COLOUR_STD = 0.01  # of a colour's size in the picture against the reference colour's
PART_STD = 10.0  # of a camera's part, before it is measured, in its own units
MODE_STD = 10.0  # waves RMS, of a mode before it is measured
EXACT = 1e-9  # the error of what is held exact, in the units of its column
STEP = 1e-6  # relative, of the differences that give the laws' slopes
OPEN_MM = 1e5  # the error of a best focus before it is measured
OPEN = ("best focus", "lateral colour", "part", "mode")  # columns of which nothing is known before
GEOMETRY = ("focal length", "f-number", "pupil magnification", "tape", "homing", "steps", "target size")


@dataclass(frozen=True)
class Stated:
    """What a plan says of lens, target and rail, with standard errors. size_std, wavelength_std (by channel): relative."""

    focal_length: Uncertain
    f_number: Uncertain
    size_std: float
    range_std_mm: float
    range_zero_std_mm: float
    homing_std_mm: float
    wavelength_std: dict[str, float]
    reference_nm: float
    convention: Convention = "corrected"

    @classmethod
    def of(cls, plan: Plan) -> Stated:
        """The plan's."""
        size = plan.target.stated_size
        return cls(
            plan.lens.stated_focal_length,
            plan.lens.stated_f_number,
            size.std / size.value,
            plan.fit.range_std_mm,
            plan.fit.range_zero_std_mm,
            plan.rail.homing_std_mm if plan.rail else 0.0,
            {c.name: c.stated_wavelength.std / c.wavelength_nm for c in plan.channel},
            plan.reference_wavelength_nm,
            plan.fit.convention,
        )


@dataclass(frozen=True)
class Member:
    """One fit of a session. range_mm: as the rail was read; stop: names the place where it stood, whose range has one error;
    homings: of its photographs, how often the rail had been homed."""

    channel: str
    range_mm: float
    stop: float
    measured: Measured
    homings: tuple[int, ...] = ()

    def part_of(self, label: str) -> tuple[str, ...]:
        """Whose number a part's is."""
        return whose(label, self.channel)


def whose(label: str, channel: str) -> tuple[str, ...]:
    """Whose number a part's is: one camera's, but each channel has its own light."""
    return (label, channel) if label == SPECTRUM_WIDTH else (label,)


@dataclass(frozen=True)
class Column:
    """A number that is estimated. kind: its group, in a budget's words where it is geometry; of: which of the group.
    value, std: before the session, std the prior error; scale: a step of it that matters."""

    kind: str
    of: tuple[str | float, ...]
    value: float
    std: float
    scale: float


@dataclass(frozen=True)
class LensModel:
    """Members, what is stated, and the columns of the estimate.

    shared: modes but defocus are the same at all ranges. paraxial: the cone at the sensor and the picture's scale follow from
    the pupils of a lens that moves as a whole; else they are tied to nothing, and only defocus bears on the lens. lean: by how
    much the target's makes all sizes less, as ln, and its error, which is none of one size beside another; None where it
    differs from range to range.
    """

    members: tuple[Member, ...]
    stated: Stated
    shared: bool = True
    paraxial: bool = True
    columns: tuple[Column, ...] = field(init=False, repr=False)
    lean: tuple[float, float] | None = field(init=False, repr=False)
    _index: dict[tuple[str, tuple[str | float, ...]], int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lean", _common_lean([m.measured.shortening for m in self.members]))
        columns = tuple(self._columns())
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "_index", {(c.kind, c.of): k for k, c in enumerate(columns)})

    @property
    def channels(self) -> tuple[str, ...]:
        """Each once, in the order of the members."""
        return tuple(dict.fromkeys(m.channel for m in self.members))

    @property
    def reference(self) -> str:
        """The channel whose sizes the lens's scale is held to: green, where there is one."""
        return "G" if "G" in self.channels else self.channels[0]

    def size_error(self, k: int) -> float:
        """Relative error of a member's size, beside the frames' own: that of its lean, where that is not shared, is in it."""
        own = 0.0 if self.lean is not None else self.members[k].measured.shortening[1]
        return float(np.hypot(self.size_floor, own))

    @property
    def size_floor(self) -> float:
        """Relative error of each size in the picture, beside the frames' own."""
        return SIZE_FLOOR if self.paraxial else FREE_SIZE

    def index(self, kind: str, *of: str | float) -> int:
        """Of a column. Raises KeyError for one that is not estimated."""
        return self._index[kind, of]

    def lens(self, theta: Floats) -> ThinLens:
        """The lens at a point of the estimate."""
        f, n, pupils = (theta[self.index(kind)] for kind in GEOMETRY[:3])
        return ThinLens(float(f), float(n), float(np.exp(pupils)))

    def true(self, theta: Floats) -> list[Floats]:
        """Modes, parts, ln of the cone's f-number and ln of the scale at each member, as `Measured` has them."""
        laws = self._laws(self._arguments(theta))
        return [self._one(k, theta, laws[:, k]) for k in range(len(self.members))]

    def predicted(self, theta: Floats) -> list[Floats]:
        """What each member should measure.

        A light of another wavelength than stated makes the same picture through a cone narrower by as much, with paths
        shorter by as much: N grows with the wavelength's error, the modes shrink.
        """
        return [value + slope * theta[at] for value, slope, at in self._with_wavelengths(theta)]

    def jacobian(self, theta: Floats) -> list[Floats]:
        """Of each member's prediction, (values, columns)."""
        arguments = self._arguments(theta)
        steps = STEP * np.maximum(np.abs(arguments), 0.1)
        moved = arguments[:, None] + steps[:, None] * np.eye(len(steps))[:, :, None]
        back = arguments[:, None] - steps[:, None] * np.eye(len(steps))[:, :, None]
        slopes = np.moveaxis((self._laws(moved) - self._laws(back)) / (2 * steps), 0, 1)
        rows = [self._rows(k, slopes[:, :, k]) for k in range(len(self.members))]
        for member, row, (_, slope, at) in zip(self.members, rows, self._with_wavelengths(theta), strict=True):
            row[: len(member.measured.noll)] *= 1 - theta[at]
            row[:, at] = slope
        return rows

    def _with_wavelengths(self, theta: Floats) -> list[tuple[Floats, Floats, int]]:
        """Of each member what is true, its slope by the relative error of the wavelength, and the column of that."""
        result = []
        for member, value in zip(self.members, self.true(theta), strict=True):
            modes = len(member.measured.noll)
            slope = np.concatenate([-value[:modes], np.zeros(len(value) - modes)])
            slope[-2] = 1.0
            result.append((value, slope, self.index("wavelength", member.channel)))
        return result

    def _columns(self) -> list[Column]:
        stated, channels = self.stated, self.channels
        far = max(m.range_mm for m in self.members)
        f, n = stated.focal_length, stated.f_number
        columns = [
            Column(GEOMETRY[0], (), f.value, f.std, 1e-2 * f.value),
            Column(GEOMETRY[1], (), n.value, n.std, 1e-2 * n.value),
            Column(GEOMETRY[2], (), 0.0, USUAL_LOG_MAGNIFICATION, 0.1),
            Column(GEOMETRY[3], (), 0.0, stated.range_zero_std_mm, 1e-3 * far),
            Column(GEOMETRY[6], (), 0.0, float(np.hypot(stated.size_std, (self.lean or (0.0, 0.0))[1])), 1e-4),
            Column("cone", (), 0.0, 0.0 if self.paraxial else FREE_CONE, 1e-2),
        ]
        homings = sorted({h for m in self.members for h in m.homings})
        columns += [Column(GEOMETRY[4], (h,), 0.0, stated.homing_std_mm, 1e-2) for h in homings[1:]]
        for stop in sorted({m.stop for m in self.members}):
            columns.append(Column(GEOMETRY[5], (stop,), 0.0, stated.range_std_mm, 1e-2))
        columns += [Column("best focus", (c,), far, OPEN_MM, 1e-3 * far) for c in channels]
        columns += [Column("wavelength", (c,), 0.0, stated.wavelength_std.get(c, 0.0), 1e-3) for c in channels]
        columns += [Column("lateral colour", (c,), 0.0, COLOUR_STD, 1e-4) for c in channels if c != self.reference]
        parts = [m.part_of(label) for m in self.members for label in m.measured.parts]
        columns += [Column("part", of, 0.0, PART_STD, 1e-3) for of in dict.fromkeys(parts)]
        modes = [(self._mode_of(k), j) for k, m in enumerate(self.members) for j in m.measured.noll if j != 4]
        columns += [Column("mode", (*of, j), 0.0, MODE_STD, 1e-2) for of, j in dict.fromkeys(modes)]
        return columns

    def _mode_of(self, k: int) -> tuple[str | float, ...]:
        """Whose modes member k has: those of its channel, or its own."""
        member = self.members[k]
        return (member.channel,) if self.shared else (member.channel, member.range_mm, k)

    def _arguments(self, theta: Floats) -> Floats:
        """Of the laws, (6, members): f, N, ln mp, true range, true best focus of the channel, and of the reference."""
        zero, count = theta[self.index("tape")], len(self.members)
        common = [np.full(count, theta[self.index(kind)]) for kind in GEOMETRY[:3]]
        ranges = [m.range_mm + zero + self._offset(m, theta) for m in self.members]
        focus = [theta[self.index("best focus", m.channel)] + zero for m in self.members]
        reference = np.full(count, theta[self.index("best focus", self.reference)] + zero)
        return np.array([*common, ranges, focus, reference])

    def _offset(self, member: Member, theta: Floats) -> float:
        """Of a member's range, beside the tape's zero, mm."""
        shares = self._homing_shares(member)
        return float(theta[self.index("steps", member.stop)] + sum(theta[k] * share for k, share in shares))

    def _homing_shares(self, member: Member) -> list[tuple[int, float]]:
        """Columns of the homings after the first, and the share of the member's photographs taken after each."""
        known = [(self._index.get((GEOMETRY[4], (h,))), h) for h in dict.fromkeys(member.homings)]
        return [(k, member.homings.count(h) / len(member.homings)) for k, h in known if k is not None]

    def _laws(self, arguments: Floats) -> Floats:
        """(3, ...): defocus in waves RMS, ln of the cone's f-number, ln of the picture's scale. arguments: (6, ...)."""
        f, n, pupils = arguments[:3]
        lens = ThinLens(*cast(tuple[float, float, float], (f, n, np.exp(pupils))))  # arrays of lenses
        ranges, focus, reference = np.maximum(arguments[3:], 1.01 * f)
        colour = lens.in_colour(focus, reference)
        ranges = np.maximum(ranges, 1.01 * colour.focal_length_mm)
        return np.stack(
            [
                defocus_waves(colour, ranges, focus, self.stated.reference_nm, self.stated.convention),
                np.log(colour.working_f_number(focus)),
                np.log(lens.chief_ray_scale(ranges, reference)),
            ]
        )

    def _one(self, k: int, theta: Floats, laws: Floats) -> Floats:
        member = self.members[k]
        modes = [laws[0] if j == 4 else theta[self.index("mode", *self._mode_of(k), j)] for j in member.measured.noll]
        size = laws[2] + theta[self.index("target size")] - (self.lean or member.measured.shortening)[0]
        if member.channel != self.reference:
            size += theta[self.index("lateral colour", member.channel)]
        parts = [theta[self.index("part", *member.part_of(label))] for label in member.measured.parts]
        return np.array([*modes, *parts, laws[1] + theta[self.index("cone")], size])

    def _rows(self, k: int, slopes: Floats) -> Floats:
        """(values, columns) of one member. slopes: (6, 3) of the laws by their arguments."""
        member = self.members[k]
        noll = member.measured.noll
        rows = np.zeros((len(member.measured.values), len(self.columns)))
        laws = [noll.index(4), -2, -1]
        by_range, by_focus, by_reference = slopes[3:]
        for kind, slope in zip(GEOMETRY[:3], slopes[:3], strict=True):
            rows[laws, self.index(kind)] = slope
        rows[laws, self.index("tape")] = by_range + by_focus + by_reference
        rows[laws, self.index("steps", member.stop)] = by_range
        for column, share in self._homing_shares(member):
            rows[laws, column] = share * by_range
        rows[laws, self.index("best focus", member.channel)] += by_focus
        rows[laws, self.index("best focus", self.reference)] += by_reference
        rows[-2, self.index("cone")] = rows[-1, self.index("target size")] = 1.0
        if member.channel != self.reference:
            rows[-1, self.index("lateral colour", member.channel)] = 1.0
        for row, j in enumerate(noll):
            if j != 4:
                rows[row, self.index("mode", *self._mode_of(k), j)] = 1.0
        for row, label in enumerate(member.measured.parts, len(noll)):
            rows[row, self.index("part", *member.part_of(label))] = 1.0
        return rows


def _common_lean(every: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """What each member says of it, in one: as the member has it that knows best, where the others agree."""
    best, error = min(every, key=lambda one: one[1])
    misfit = sum((value - best) ** 2 / (std**2 + error**2 + LEAN_FLOOR**2) for value, std in every)
    return (best, error) if chdtrc(len(every), misfit) > SAME_LEAN else None
