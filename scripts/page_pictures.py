"""Takes pictures of the page as a person sees it: python scripts/page_pictures.py ADDRESS OUT [ANOTHER ADDRESS...]

ADDRESS is a running station with a map in use (`make demo`). A station without robot or map (the empty state) or
one that asks for a token (the login) can follow. Laptop and phone, dark and light, every dialog. With a simulated robot
the last pictures are of a hijack. Look at them on a quiet machine: late pictures are shown as late.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

SCREENS: dict[str, dict[str, Any]] = {
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
# What opens a dialog, by its name in the file.
DIALOGS = {
    "room": ".plan-room",
    "place": ".place-label, .plan-place",
    "navigation": "#navigations button[aria-label^='More about']",
    "map": "#maps button[aria-label^='More about']",
    "hijack-dialog": "#hijack",
}


class Camera:
    """Pictures of one page."""

    def __init__(self, page: Page, out: Path, name: str) -> None:
        self.page, self._out, self._name = page, out, name

    def take(self, what: str, whole: bool = False) -> None:
        self.page.wait_for_timeout(1000)  # for what is drawn a few times a second
        path = self._out / f"{self._name}-{what}.jpg"
        self.page.screenshot(path=path, type="jpeg", quality=80, full_page=whole)

    def dialog(self, what: str, opener: str) -> None:
        found = self.page.locator(opener)
        if not found.count() or not found.first.is_visible():
            return
        found.first.dispatch_event("click")
        self.take(what)
        rename = self.page.locator("dialog[open]").get_by_role("button", name="Rename")
        if rename.count():
            rename.click()
            self.take(f"{what}-rename")
        self.page.keyboard.press("Escape")


def look_around(camera: Camera) -> None:
    """A station that works."""
    page = camera.page
    page.wait_for_selector("#video[data-seq]")
    page.wait_for_selector(".age:not(.bad)")
    camera.take("first")
    camera.take("whole", whole=True)
    for what, opener in DIALOGS.items():
        camera.dialog(what, opener)
    pen = page.locator("#draw-door")
    if pen.is_visible():
        pen.click()
        page.locator(".map").scroll_into_view_if_needed()
        camera.take("pen")
        pen.click()
    page.locator("[data-layer=map]").click()  # the plan lies over it
    page.locator("[data-view=free]").click()
    page.locator("#scene").scroll_into_view_if_needed()
    camera.take("free")
    show = page.locator("#comparisons").get_by_role("button", name="Show")
    if show.count():
        show.first.click()
        camera.take("comparison")
        page.locator("[data-registered=false]").click()
        camera.take("comparison-before")
        page.locator("#review-close").click()
    if page.locator("#navigations li.ready").count():
        page.locator("#navigations li.ready").first.get_by_role("button", name="More about").click()
        page.locator("#navigation-dialog").get_by_role("button", name="Replay").click()
        page.wait_for_timeout(3000)
        camera.take("replay")
        page.locator("#review-close").click()


def hijack(browser: Browser, address: str, out: Path) -> None:
    """Carried to another room; the log and the card tell it."""
    page = browser.new_page(**SCREENS["laptop"], color_scheme="dark")
    page.goto(address)
    page.wait_for_selector("#video[data-seq]")
    camera = Camera(page, out, "dark-laptop")
    if page.locator("#hijack").is_visible():
        page.locator("#hijack").click()
        page.locator("#ask button[type=submit]").click()
        page.wait_for_selector("#log [data-topic=hijack]")
        camera.take("hijack-begins")
        page.wait_for_timeout(12_000)
        camera.take("hijack")
    page.close()


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    address, out, others = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        for theme in ("dark", "light"):
            for screen, options in SCREENS.items():
                context = browser.new_context(**options, color_scheme=theme, ignore_https_errors=True)
                for number, other in enumerate(others, start=1):
                    page = context.new_page()
                    page.goto(other)
                    Camera(page, out, f"{theme}-{screen}").take(f"other-{number}", whole=True)
                    page.close()
                page = context.new_page()
                page.goto(address)
                look_around(Camera(page, out, f"{theme}-{screen}"))
                context.close()
        hijack(browser, address, out)
        browser.close()


if __name__ == "__main__":
    main()
