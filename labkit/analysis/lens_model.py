"""What a session's fits have in common: one lens, one sensor at rest, one rail (thesis §4.5.2, Appendix E).

Every fit measures modes, the cone's f-number and the picture's scale. All follow from a few numbers that hold for the whole
session, some of which a plan states with an error: a measurement like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
from scipy.special import chdtrc

from labkit.imaging.optics import ESTIMATED
from labkit.inference.cone import Measured
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, Convention, ThinLens, defocus_waves
from labkit.plan import Plan, leading_channel
from labkit.types import Bools, Floats, Indices
from labkit.uncertain import Uncertain

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
    """Whose number a part's is: one camera's, but of some parts each channel has its own."""
    group = ESTIMATED[label.partition(".")[0]]
    return (label, channel) if group.per_channel else (label,)


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
class _Layout:
    """How the members' values, one after another, follow from the columns.

    linear (rows, columns), offset (rows,): what is a sum; of_arguments (6, members, columns), stated (6, members): the laws'
    arguments; laws (3, members): the rows that those give; modes: which rows are; wavelength (rows,): column of each row's.
    """

    linear: Floats
    offset: Floats
    of_arguments: Floats
    stated: Floats
    laws: Indices
    modes: Bools
    wavelength: Indices

    def arguments(self, theta: Floats) -> Floats:
        """Of the laws, (6, members)."""
        return np.asarray(self.stated + self.of_arguments @ theta)


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
        return leading_channel(self.channels)

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
        return self.by_member(self._true(theta))

    def predicted(self, theta: Floats) -> list[Floats]:
        """What each member should measure."""
        return self.by_member(self.all_predicted(theta))

    def jacobian(self, theta: Floats) -> list[Floats]:
        """Of each member's prediction, (values, columns)."""
        return self.by_member(self.whole_jacobian(theta))

    def by_member(self, rows: Floats) -> list[Floats]:
        """What belongs to each member of (rows, ...) of all."""
        return np.split(rows, np.cumsum([len(m.measured.values) for m in self.members])[:-1])

    def all_predicted(self, theta: Floats) -> Floats:
        """(rows,) what the members should measure, one after another.

        A light of another wavelength than stated makes the same picture through a cone narrower by as much, with paths
        shorter by as much: N grows with the wavelength's error, the modes shrink.
        """
        true, errors = self._true(theta), theta[self._layout.wavelength]
        return true + self._by_wavelength(true) * errors

    def whole_jacobian(self, theta: Floats) -> Floats:
        """(rows, columns) of `all_predicted`."""
        layout = self._layout
        arguments = layout.arguments(theta)
        steps = STEP * np.maximum(np.abs(arguments), 0.1)
        moved = arguments[:, None] + steps[:, None] * np.eye(len(steps))[:, :, None]
        back = arguments[:, None] - steps[:, None] * np.eye(len(steps))[:, :, None]
        slopes = (self._laws(moved) - self._laws(back)) / (2 * steps)
        whole = layout.linear.copy()
        whole[layout.laws] += np.einsum("lam,amc->lmc", slopes, layout.of_arguments)
        whole[layout.modes] *= 1 - theta[layout.wavelength[layout.modes], None]
        whole[np.arange(len(whole)), layout.wavelength] = self._by_wavelength(self._true(theta))
        return whole

    def _true(self, theta: Floats) -> Floats:
        """(rows,) modes, parts, ln of the cone's f-number and ln of the scale of the members, one after another."""
        layout = self._layout
        true = layout.linear @ theta + layout.offset
        true[layout.laws] += self._laws(layout.arguments(theta))
        return true

    def _by_wavelength(self, true: Floats) -> Floats:
        """(rows,) slopes of what is measured by the relative error of the light's wavelength."""
        slope = np.where(self._layout.modes, -true, 0.0)
        slope[self._layout.laws[1]] = 1.0
        return slope

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

    @cached_property
    def _layout(self) -> _Layout:
        members, count = self.members, len(self.members)
        sizes = [len(m.measured.values) for m in members]
        ends = np.cumsum(sizes)
        linear, offset = np.zeros((int(ends[-1]), len(self.columns))), np.zeros(int(ends[-1]))
        of_arguments, stated = np.zeros((6, count, len(self.columns))), np.zeros((6, count))
        laws, modes = np.empty((3, count), dtype=np.intp), np.zeros(int(ends[-1]), dtype=bool)
        for k, (member, end) in enumerate(zip(members, ends, strict=True)):
            own = slice(end - sizes[k], end)
            defocus = end - sizes[k] + member.measured.noll.index(4)
            laws[:, k] = defocus, end - 2, end - 1
            modes[own.start : own.start + len(member.measured.noll)] = True
            linear[own] = self._linear(k)
            offset[end - 1] = -(self.lean or member.measured.shortening)[0]
            of_arguments[:, k], stated[3, k] = self._of_arguments(member), member.range_mm
        wavelength = [self.index("wavelength", m.channel) for m in members]
        return _Layout(linear, offset, of_arguments, stated, laws, modes, np.repeat(wavelength, sizes))

    def _linear(self, k: int) -> Floats:
        """(values, columns) of member k by what it has in common with others as it is, laws apart."""
        member, noll = self.members[k], self.members[k].measured.noll
        rows = np.zeros((len(member.measured.values), len(self.columns)))
        rows[-2, self.index("cone")] = rows[-1, self.index("target size")] = 1.0
        if member.channel != self.reference:
            rows[-1, self.index("lateral colour", member.channel)] = 1.0
        for row, j in enumerate(noll):
            if j != 4:
                rows[row, self.index("mode", *self._mode_of(k), j)] = 1.0
        for row, label in enumerate(member.measured.parts, len(noll)):
            rows[row, self.index("part", *member.part_of(label))] = 1.0
        return rows

    def _of_arguments(self, member: Member) -> Floats:
        """(6, columns) of the laws' arguments: f, N, ln mp, true range, best focus of the channel, of the reference."""
        slopes = np.zeros((6, len(self.columns)))
        for row, kind in enumerate(GEOMETRY[:3]):
            slopes[row, self.index(kind)] = 1.0
        slopes[3:, self.index("tape")] = 1.0
        slopes[3, self.index("steps", member.stop)] = 1.0
        for homing in dict.fromkeys(member.homings):
            if (column := self._index.get((GEOMETRY[4], (homing,)))) is not None:  # all but the first
                slopes[3, column] = member.homings.count(homing) / len(member.homings)
        slopes[4, self.index("best focus", member.channel)] = 1.0
        slopes[5, self.index("best focus", self.reference)] = 1.0
        return slopes

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


def _common_lean(every: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """What each member says of it, in one: as the member has it that knows best, where the others agree."""
    best, error = min(every, key=lambda one: one[1])
    misfit = sum((value - best) ** 2 / (std**2 + error**2 + LEAN_FLOOR**2) for value, std in every)
    return (best, error) if chdtrc(len(every), misfit) > SAME_LEAN else None
