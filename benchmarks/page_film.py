"""A moving picture of a run's report page, for README and docs: one picture of the page for every few frames.

    bayesnet-track init mine.yaml --yes
    bayesnet-track run mine.yaml --source cup.mp4 --init 305,122,112,262 --out runs/cup
    bayesnet-track report runs/cup
    python benchmarks/page_film.py runs/cup/report.html docs/figures/cup.webp --frames 42,92,2

`cup.mp4` is part of OpenCV's documentation (Apache-2.0; in Debian: `opencv-doc`). Needs Selenium, Pillow,
Chromium and its driver.
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path
from typing import Any

from PIL import Image

SIZE, SHOWN = (1120, 860), (896, 688)
"""Pixels of the browser's window and of the picture."""
FRAME_MS, LAST_MS = 150, 1500
SHOWS = """
const frame = document.querySelector('.picture canvas')?.dataset.frame;
return frame === arguments[0];
"""


def main() -> None:
    """Open the page at each frame, and write what the browser shows."""
    parser = argparse.ArgumentParser(description="a moving picture of a report page")
    parser.add_argument("page", type=Path, help="report.html of a run")
    parser.add_argument("out", type=Path, help="animated WebP to write")
    parser.add_argument("--frames", default="0,100,4", help="first, end and step (default 0,100,4)")
    options = parser.parse_args()
    pictures = shots(options.page, list(range(*map(int, options.frames.split(",")))))
    times = [FRAME_MS] * (len(pictures) - 1) + [LAST_MS]
    pictures[0].save(
        options.out, save_all=True, append_images=pictures[1:], duration=times, loop=0, quality=40
    )
    print(f"{options.out}: {len(pictures)} pictures, {options.out.stat().st_size // 1000} kB")


def shots(page: Path, frames: list[int]) -> list[Image.Image]:
    """What the page shows at each frame."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service
    from selenium.webdriver.support.ui import WebDriverWait

    asked = webdriver.ChromeOptions()
    for flag in ("--headless", "--no-sandbox", "--hide-scrollbars"):
        asked.add_argument(flag)
    with webdriver.Chrome(asked, Service(shutil.which("chromedriver"))) as driver:
        metrics = {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        driver.get(page.absolute().as_uri())
        return [_shot(driver, WebDriverWait(driver, 20), frame) for frame in frames]


def _shot(driver: Any, waiting: Any, frame: int) -> Image.Image:
    driver.execute_script("location.hash = arguments[0]", f"frame={frame}")
    waiting.until(lambda it: it.execute_script(SHOWS, str(frame)))
    driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    with Image.open(io.BytesIO(driver.get_screenshot_as_png())) as picture:
        return picture.convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
