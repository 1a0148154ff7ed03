"""Chromium without a screen, for tests of pages: found, or told loudly what is missing."""

from __future__ import annotations

import os
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

from missing import missing, needed_module

# Without those of the network Chromium looks for hosts at every start, which closed networks refuse.
_FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
          "--disable-background-networking", "--disable-component-update", "--disable-sync", "--window-size=1280,860",
          "--disable-backgrounding-occluded-windows", "--disable-renderer-backgrounding",
          "--disable-background-timer-throttling", "--disable-dev-shm-usage")


@contextmanager
def browser(folder):
    """Yields a selenium driver of a Chromium with a new profile in `folder`."""
    webdriver = needed_module("selenium.webdriver", "pip install 'glrender[test]'")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        missing("CHROMIUM OR CHROMEDRIVER", "make chromium")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*_FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    found.set_page_load_timeout(120)
    found.set_script_timeout(120)
    try:
        yield found
    finally:
        found.quit()


def processes_of(folder):
    """Numbers of the processes of the Chromium with this profile, the first the browser itself."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if f"--user-data-dir={folder}".encode() in command and b"chromedriver" not in command.split(b"\0")[0]:
                found.append(int(entry.name))
    return sorted(found)


@contextmanager
def frozen(folder):
    """Stop every process of a Chromium for a while."""
    stopped = processes_of(folder)
    assert stopped, "no process of this browser was found"
    for number in stopped:
        os.kill(number, signal.SIGSTOP)
    try:
        yield
    finally:
        for number in stopped:
            os.kill(number, signal.SIGCONT)
