"""A real browser for the tests of pages, headless.

Where there is no Chromium the tests are skipped and say so; RETUNER_REQUIRE_BROWSER=1 (as in CI) makes that a failure.
RETUNER_SCREENSHOTS names a folder for pictures of what was seen.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

PROGRAM = next((path for path in map(shutil.which, ("chromium", "chromium-browser")) if path), "")
DRIVER = shutil.which("chromedriver") or ""
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
WITHIN_S = 60  # Longest wait for something to be seen: a busy machine is slow, and nothing is measured here


class Seen:
    """What a person sees and does."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, address: str) -> None:
        self.driver.get(address)

    def text(self) -> str:
        return self.driver.find_element(By.TAG_NAME, "body").text

    def wait(self, condition: Callable[[], object], what: str) -> None:
        WebDriverWait(self.driver, WITHIN_S, poll_frequency=0.1, ignored_exceptions=[Exception]).until(
            lambda _: condition(), f"{what}; seen: {self.text()[:1500]}"
        )

    def sees(self, text: str) -> None:
        self.wait(lambda: text in self.text(), f"{text!r} is not seen")

    def button(self, name: str) -> WebElement:
        return self.driver.find_element(By.XPATH, f"//button[normalize-space()='{name}'][not(@hidden)]")

    def press(self, name: str) -> None:
        self.wait(lambda: self.button(name).is_displayed(), f"there is no button {name!r}")
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", self.button(name))
        self.button(name).click()

    def confirms(self, who: str) -> None:
        """Give a name where it is asked for, and say yes."""
        self.wait(lambda: self.driver.find_element(By.ID, "ask").get_attribute("open"), "nothing is asked")
        name = self.driver.find_element(By.ID, "ask-name")
        name.clear()
        name.send_keys(who)
        self.press("Yes, do it")
        self.sees("Requested:")

    def errors(self) -> list[str]:
        """What the browser complains of: scripts that fail, a policy that is violated."""
        harmless = ("ERR_CONNECTION", "ERR_INCOMPLETE")
        told = [one["message"] for one in self.driver.get_log("browser") if one["level"] == "SEVERE"]
        return [text for text in told if not any(part in text for part in harmless)]

    def picture(self, name: str) -> None:
        if folder := os.environ.get("RETUNER_SCREENSHOTS"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.driver.save_screenshot(str(Path(folder) / f"{name}.png"))

    def wider_than_the_screen(self) -> bool:
        return bool(self.driver.execute_script("return document.documentElement.scrollWidth > innerWidth + 1"))


@contextmanager
def windows(folder: Path) -> Iterator[Callable[..., "Seen"]]:
    """A function that opens a window of a size, light or dark; all are closed at the end."""
    if not (PROGRAM and DRIVER):
        reason = "no Chromium: apt-get install chromium chromium-driver"
        if os.environ.get("RETUNER_REQUIRE_BROWSER"):
            pytest.fail(f"RETUNER_REQUIRE_BROWSER is set, but there is {reason}")
        pytest.skip(reason)
    opened: list[webdriver.Chrome] = []

    def open_(width: int = 1300, height: int = 1000, *, dark: bool = False) -> Seen:
        options = Options()
        options.binary_location = PROGRAM
        for flag in (*FLAGS, f"--user-data-dir={folder / f'browser-{len(opened)}'}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        driver = webdriver.Chrome(options=options, service=Service(DRIVER))
        opened.append(driver)
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        if dark:
            media = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        return Seen(driver)

    try:
        yield open_
    finally:
        for driver in opened:
            driver.quit()
