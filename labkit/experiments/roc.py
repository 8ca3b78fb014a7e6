"""ROC curves of tests for a local optimum on the sinusoid: thesis Figures 4.5, 4.8, 4.12."""

import numpy as np
from matplotlib.figure import Figure

from labkit.experiments.runner import Claim, Outcome, Setting
from labkit.experiments.sinusoid import TRUE, X, chirp_gap, find_optima, linear_gap, one_sided, relaxation, two_sided
from labkit.report.style import SOFT
from labkit.types import Floats

SEED = 4


def run(setting: Setting) -> Outcome:
    """Each test on the global and on the deepest wrong optimum of many draws; how often the first looks worse."""
    draws = 150 if setting.quick else 4000
    tests = {
        "Biernacki, two-sided": two_sided,
        "one-sided": one_sided,
        "embedding, chirp, 1 degree": chirp_gap(1),
        "embedding, chirp, 3 degrees": chirp_gap(3),
        "embedding, Algorithm 4.9, 1 degree": linear_gap(relaxation()),
    }
    rng = np.random.default_rng(SEED)
    right: dict[str, list[float]] = {name: [] for name in tests}
    wrong: dict[str, list[float]] = {name: [] for name in tests}
    for k in range(draws):
        data = np.sin(TRUE * X) + rng.normal(size=X.size)
        optima = find_optima(data)
        if optima is not None and abs(optima.best - TRUE) < 0.5:  # the global optimum is the true one
            for name, test in tests.items():
                right[name].append(test(data, optima.best))
                wrong[name].append(test(data, optima.other))
        setting.progress(k + 1, draws, "draws")
    alarms = np.linspace(0, 1, 101)
    curves = {name: detection(np.array(right[name]), np.array(wrong[name]), alarms) for name in tests}
    rows = [
        {"false_alarm": float(a), **{name: float(curve[i]) for name, curve in curves.items()}}
        for i, a in enumerate(alarms)
    ]
    count = len(right["one-sided"])
    claims = [
        Claim(f"area under the ROC, {name}", None, area(np.array(right[name]), np.array(wrong[name])), "", count)
        for name in tests
    ]
    least = float(np.min(curves["one-sided"] - curves["Biernacki, two-sided"]))
    claims.append(Claim("least lead of one-sided over two-sided at any false-alarm rate", 0.0, least, "", count))

    def draw() -> Figure:
        figure = Figure(figsize=(5.2, 4.4), layout="constrained")
        axes = figure.subplots()
        for name, curve in curves.items():
            axes.plot(alarms, curve, label=name)
        axes.plot([0, 1], [0, 1], color=SOFT, linewidth=0.8, linestyle=":")
        axes.set(xlabel="false alarms", ylabel="wrong optima detected", title="A sinusoid's frequency in unit noise")
        axes.legend(loc="lower right")
        return figure

    return Outcome(claims, rows, draw)


def detection(right: Floats, wrong: Floats, alarms: Floats) -> Floats:
    """Share of wrong optima above the threshold that so many right ones exceed."""
    thresholds = np.quantile(right, 1 - alarms)
    return np.asarray(np.mean(wrong[:, None] > thresholds, axis=0))


def area(right: Floats, wrong: Floats) -> float:
    """Chance that a wrong optimum looks worse than a right one."""
    return float(np.mean(wrong[:, None] > right) + 0.5 * np.mean(wrong[:, None] == right))
