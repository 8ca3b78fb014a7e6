"""The gallery of reports: each with its command. `docs.draw_gallery` makes the reports and their pictures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Example:
    """A report, how to make it, and where it then lies."""

    name: str
    title: str
    commands: tuple[str, ...]
    words: str
    report: str


PHOTOGRAPHS = "PHOTOGRAPHS"
"""A folder that whoever runs a command has to have."""

MAKE_PHOTOGRAPHS = "python examples/practice_photographs.py photographs"
EXAMPLES = (
    Example(
        "demo",
        "A session of three colours",
        ("labkit demo",),
        "A simulated 70 mm f/2.8 lens at three ranges, in red, green and blue, from capture to report. The truth is printed "
        "beside the estimate.",
        "labkit-demo/results/latest/report.html",
    ),
    Example(
        "tutorial",
        "The tutorial's lens",
        (
            MAKE_PHOTOGRAPHS,
            "labkit import frames.csv plan.toml lens",
            "labkit fit lens",
            "labkit report lens",
        ),
        "Two small photographs, one colour, as in the [tutorial](tutorials/files.md), which has `plan.toml` and `frames.csv`.",
        "lens/results/latest/report.html",
    ),
    Example(
        "rejected",
        "A model that does not fit",
        ("labkit fit lens --noll 4:6 --name few", "labkit report lens --name few"),
        "The same photographs, fitted with defocus and astigmatism alone. The lens has more, so residuals are not noise alone, "
        "and the report says so. Look for this before you believe any number.",
        "lens/results/few/report.html",
    ),
    Example(
        "real",
        "A lone real photograph",
        (
            f"python examples/real_photograph.py {PHOTOGRAPHS} real",
            "labkit report real/session",
        ),
        "A printed noise target, photographed by others: once, by an unknown lens, without range, darks or flats. "
        "`PHOTOGRAPHS` is the folder with their files (Delbracio, Muse, Almansa, *Non-parametric sub-pixel local PSF "
        "estimation*, IPOL); their photograph is not ours to show, so the picture ends above it. The first command also "
        "prints their own program's MTF beside labkit's. The report says that the optimum is settled and that the model does "
        "not explain all.",
        "real/session/results/latest/report.html",
    ),
)


def gallery() -> str:
    """A section for each report."""
    parts = []
    for example in EXAMPLES:
        parts += [
            f"## {example.title}\n",
            f"{example.words}\n",
            "```text\n" + "\n".join(example.commands) + "\n```\n",
        ]
        parts.append(
            f"![The top of the report: {example.title}](gallery/{example.name}.png)\n"
        )
    return "\n".join(parts)
