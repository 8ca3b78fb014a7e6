"""Combine the gain and read noise that a plan states with those of the session's own flats and darks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import hypot

from labkit.calibration.photon_transfer import NoiseEstimate
from labkit.findings.findings import Finding, found
from labkit.plan import Channel
from labkit.uncertain import Uncertain

UNMEASURED = NoiseEstimate(None, None, None, None)
"""Of a channel without flats and darks."""

MOST_SIGMAS = 5.0
"""Stated and measured numbers farther apart belong to different cameras or ISOs."""


def with_stated(measured: NoiseEstimate, channel: Channel) -> NoiseEstimate:
    """Return the weighted mean of measured and stated numbers; the measured one alone where they contradict."""
    gain = _together(_gain(measured), channel.stated_gain)
    read = _together(_read_noise(measured), channel.stated_read_noise)
    return NoiseEstimate(
        None if gain is None else gain.value,
        None if gain is None else gain.std,
        None if read is None else read.value,
        None if read is None else read.std,
    )


def noise_findings(
    measured: Mapping[str, NoiseEstimate], channels: Sequence[Channel]
) -> Iterator[Finding]:
    """Return the channels whose stated noise contradicts their measured noise."""
    for channel in channels:
        estimate = measured[channel.name]
        pairs = {
            "gain_counts_per_e": (_gain(estimate), channel.stated_gain),
            "read_noise_counts": (_read_noise(estimate), channel.stated_read_noise),
        }
        for key, (own, stated) in pairs.items():
            if own and stated and _contradict(own, stated):
                yield found(
                    "noise-contradicts-plan",
                    channel=channel.name,
                    key=key,
                    stated=stated.value,
                    measured=own.value,
                    std=own.std,
                )


def _gain(estimate: NoiseEstimate) -> Uncertain | None:
    return _number(estimate.gain, estimate.gain_std)


def _read_noise(estimate: NoiseEstimate) -> Uncertain | None:
    return _number(estimate.read_noise, estimate.read_noise_std)


def _number(value: float | None, std: float | None) -> Uncertain | None:
    return Uncertain(value, std) if value and std else None


def _contradict(own: Uncertain, stated: Uncertain) -> bool:
    return abs(own.value - stated.value) > MOST_SIGMAS * hypot(own.std, stated.std)


def _together(own: Uncertain | None, stated: Uncertain | None) -> Uncertain | None:
    """Return the mean by inverse variances."""
    if own is None or stated is None:
        return stated or own
    if _contradict(own, stated):
        return own
    weights = own.std**-2, stated.std**-2
    total = sum(weights)
    mean = (weights[0] * own.value + weights[1] * stated.value) / total
    return Uncertain(mean, total**-0.5)
