"""Makes the gallery's reports and photographs their tops: python -m docs.draw_gallery FOLDER [PHOTOGRAPHS]

FOLDER holds the tutorial's plan.toml and frames.csv; reports that are there already are not made again. PHOTOGRAPHS holds the
real photograph, without which its report is left out. It needs Chromium and ten minutes. The pictures are kept in docs/gallery.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

from docs.generators.gallery import EXAMPLES, PHOTOGRAPHS

PICTURES = Path(__file__).parent / "gallery"
ROOT = Path(__file__).parents[1]
WIDTH, HEIGHT, SCALE = 1000, 1050, 0.75


def main(folder: Path, photographs: Path | None = None) -> None:
    """Make every report in a folder with the tutorial's plan.toml and frames.csv, and photograph it.

    photographs: of the real one; without them its report is left out, unless it is there.
    """
    PICTURES.mkdir(exist_ok=True)
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=browser_path, args=["--no-sandbox"]
        )
        page = browser.new_page(
            viewport={"width": WIDTH, "height": HEIGHT}, device_scale_factor=SCALE
        )
        for example in EXAMPLES:
            if not (folder / example.report).exists():
                if photographs is None and any(
                    PHOTOGRAPHS in command for command in example.commands
                ):
                    continue
                for command in example.commands:
                    words = (
                        command.replace("examples/", f"{ROOT}/examples/")
                        .replace(PHOTOGRAPHS, str(photographs))
                        .split()
                    )
                    subprocess.run(
                        [str(Path(sys.executable).with_name(words[0])), *words[1:]],
                        cwd=folder,
                        check=True,
                    )
            page.goto((folder / example.report).resolve().as_uri())
            page.screenshot(path=PICTURES / f"{example.name}.png")
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(Path(words).resolve() for words in sys.argv[2:3]))
