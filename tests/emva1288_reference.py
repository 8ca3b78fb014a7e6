"""Numbers of the PyPI package `emva1288` for the frames of ../shared/real/emva-ccd, held by tests/system/test_real_noise.py.

pip install emva1288==1.0.2
python -m tests.emva1288_reference ../shared/real/emva-ccd
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

NAMES = (
    *("K", "sigma_d", "QE", "u_e_sat", "u_e_min", "u_p_min", "DR", "SNR_max"),
    *("u_I_mean", "DSNU1288", "PRNU1288"),
)


def lines(folder: Path) -> list[str]:
    """Return the description's lines, of groups whose pictures are there alone."""
    kept: list[str] = []
    group: list[str] = []
    text = (folder / "EMVA1288_Data.txt").read_text(encoding="utf-8")
    for line in [*text.splitlines(), "end"]:
        if line.startswith("i "):
            picture = line[2:].strip().replace("\\", "/")
            if (folder / picture).exists():
                group.append(f"i {picture}")
            continue
        if len(group) > 1:
            kept += group
        group = [line] if line[:2] in ("b ", "d ") else []
        if line[:2] in ("v ", "n "):
            kept.append(line)
    return kept


def main(folder: Path) -> None:
    """Print a table."""
    # version 1.0.2 calls what NumPy 2 has no more
    vars(np)["asfarray"] = lambda values: np.asarray(values, float)
    process = import_module("emva1288.process")
    with TemporaryDirectory() as place:
        description = Path(place) / "data.txt"
        description.write_text("\n".join(lines(folder)) + "\n", encoding="utf-8")
        parsed = process.ParseEmvaDescriptorFile(str(description), path=str(folder))
    data = process.Data1288(process.LoadImageData(parsed.images).data)
    results = process.Results1288(data.data)
    for name in NAMES:
        print(f"{name:10} {getattr(results, name):.6g}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
