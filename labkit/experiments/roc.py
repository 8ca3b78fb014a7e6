"""ROC curves of tests for a local optimum on the sinusoid: thesis Figures 4.5, 4.8, 4.12."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure

from labkit.experiments.runner import Claim, Outcome, Setting
from labkit.experiments.sinusoid import (
    TRUE,
    Optima,
    X,
    chirp_gap,
    find_optima,
    linear_gap,
    one_sided,
    relaxation,
    two_sided,
)
from labkit.figure_style import SOFT_INK
from labkit.types import Floats, Progress, no_progress

SEED = 4
Test = Callable[[Floats, float], float]


TESTS: dict[str, Test] = {
    "Biernacki, two-sided": two_sided,
    "one-sided": one_sided,
    "embedding, chirp, 1 degree": chirp_gap(1),
    "embedding, chirp, 3 degrees": chirp_gap(3),
    "embedding, Algorithm 4.9, 1 degree": linear_gap(relaxation()),
}


def run(setting: Setting) -> Outcome:
    """Apply each test to the global and the deepest wrong optimum of many draws; count where the first looks
    worse.
    """
    rng = np.random.default_rng(SEED)
    kept = draws(rng, 150 if setting.quick else 4000, setting.progress)
    of = {name: statistics(test, kept) for name, test in TESTS.items()}
    alarms = np.linspace(0, 1, 101)
    curves = {name: detection(right, wrong, alarms) for name, (right, wrong) in of.items()}
    rows = [
        {
            "false_alarm": float(a),
            **{name: float(curve[i]) for name, curve in curves.items()},
        }
        for i, a in enumerate(alarms)
    ]
    claims = [
        Claim(f"area under the ROC, {name}", None, area(right, wrong), "", len(kept))
        for name, (right, wrong) in of.items()
    ]
    least = float(np.min(curves["one-sided"] - curves["Biernacki, two-sided"]))
    claims.append(
        Claim(
            "least lead of one-sided over two-sided at any false-alarm rate",
            0.0,
            least,
            "",
            len(kept),
        )
    )
    return Outcome(claims, rows, lambda: draw(alarms, curves))


def draw(alarms: Floats, curves: dict[str, Floats]) -> Figure:
    """Plot the curves."""
    figure = Figure(figsize=(5.2, 4.4), layout="constrained")
    axes = figure.subplots()
    for name, curve in curves.items():
        axes.plot(alarms, curve, label=name)
    axes.plot([0, 1], [0, 1], color=SOFT_INK, linewidth=0.8, linestyle=":")
    axes.set(
        xlabel="false alarms",
        ylabel="wrong optima detected",
        title="A sinusoid's frequency in unit noise",
    )
    axes.legend(loc="lower right")
    return figure


def draws(
    rng: np.random.Generator, count: int, progress: Progress = no_progress
) -> list[tuple[Floats, Optima]]:
    """Return the draws of data (100,) whose global optimum is the true one, and which have another."""
    kept = []
    for k in range(count):
        data = np.sin(TRUE * X) + rng.normal(size=X.size)
        optima = find_optima(data)
        if optima is not None and abs(optima.best - TRUE) < 0.5:
            kept.append((data, optima))
        progress(k + 1, count, "draws")
    return kept


def statistics(test: Test, kept: Sequence[tuple[Floats, Optima]]) -> tuple[Floats, Floats]:
    """Return a test's statistics of right and of wrong optima, (draws,) each."""
    right, wrong = (
        [test(data, getattr(optima, which)) for data, optima in kept]
        for which in ("best", "other")
    )
    return np.array(right), np.array(wrong)


def detection(right: Floats, wrong: Floats, alarms: Floats) -> Floats:
    """Return the share of wrong optima above the threshold for each rate of false alarms."""
    thresholds = np.quantile(right, 1 - alarms)
    return np.asarray(np.mean(wrong[:, None] > thresholds, axis=0))


def area(right: Floats, wrong: Floats) -> float:
    """Return the probability that a wrong optimum looks worse than a right one."""
    return float(np.mean(wrong[:, None] > right) + 0.5 * np.mean(wrong[:, None] == right))
