"""Takes the README's picture of a page: ``python tools/page_picture.py out/demo/report.html docs/picture.png``.

PAGE is one of ``semloc demo`` or ``semloc report replay``. Needs Playwright and Chromium, as the tests of the page do.
"""

import argparse
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

COLOURS = 256
FLAGS = ["--no-sandbox", "--no-first-run", "--disable-gpu"]


def main() -> None:
    """Open the page at a second, and photograph what a person sees first."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("page", type=Path)
    words.add_argument("picture", type=Path)
    words.add_argument("--width", type=int, default=1400)
    words.add_argument("--height", type=int, default=915, help="0: the whole page")
    words.add_argument("--keys", default="z", help="pressed then, as on the page")
    words.add_argument("--second", type=float, default=55.0, help="since the first answer")
    asked = words.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, headless=True, args=FLAGS)
        tab = browser.new_page(viewport={"width": asked.width, "height": asked.height or 800})
        tab.goto(asked.page.resolve().as_uri())
        tab.wait_for_selector("body[data-ready]")
        last = int(tab.locator("#seek").get_attribute("max") or 0)
        frame = 0
        while frame < last and _seconds(tab.locator("#clock").inner_text()) < asked.second:
            tab.keyboard.press("ArrowRight")
            frame += 1
        for key in asked.keys:
            tab.keyboard.press(key)
        tab.evaluate("document.activeElement.blur()")
        tab.screenshot(path=asked.picture, full_page=not asked.height)
        browser.close()
    Image.open(asked.picture).convert("RGB").quantize(COLOURS).save(asked.picture, optimize=True)


def _seconds(clock: str) -> float:
    """Of ``0:54.0 / 1:25.5 · 109 of 172`` the first."""
    minutes, seconds = clock.split(" ")[0].split(":")
    return 60 * float(minutes) + float(seconds)


if __name__ == "__main__":
    main()
