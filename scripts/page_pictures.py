"""Takes pictures of the page of a running station, as a person sees it: python scripts/page_pictures.py ADDRESS OUT

Laptop and phone, dark and light, with its dialogs. Look at them on a quiet machine: late pictures are shown as late.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

SCREENS = {
    "laptop": {"viewport": {"width": 1440, "height": 900}},
    "phone": {
        "viewport": {"width": 390, "height": 844},
        "has_touch": True,
        "is_mobile": True,
        "device_scale_factor": 2,
    },
}
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def take(page: Page, out: Path, name: str) -> None:
    def picture(what: str, whole: bool = False) -> None:
        page.wait_for_timeout(800)  # for what is drawn a few times a second
        page.screenshot(path=out / f"{name}-{what}.jpg", type="jpeg", quality=80, full_page=whole)

    page.wait_for_selector("#video[data-seq]")
    page.wait_for_selector(".age:not(.bad)")
    picture("first")
    picture("whole", whole=True)
    if page.locator(".place-label").count():
        page.locator(".place-label").first.dispatch_event("click")
        picture("place")
        page.keyboard.press("Escape")
    if page.get_by_role("button", name="More about").count():
        page.get_by_role("button", name="More about").first.click()
        picture("drive")
        page.keyboard.press("Escape")
    if page.locator("#hijack").is_visible():
        page.locator("#hijack").click()
        picture("hijack")
        page.keyboard.press("Escape")
    page.locator("[data-view=free]").click()
    page.locator("#scene").scroll_into_view_if_needed()
    picture("free")


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    address, out = sys.argv[1], Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        for theme in ("dark", "light"):
            for screen, options in SCREENS.items():
                page = browser.new_page(**options, color_scheme=theme)  # type: ignore[arg-type]
                page.goto(address)
                take(page, out, f"{theme}-{screen}")
                page.close()
        browser.close()


if __name__ == "__main__":
    main()
