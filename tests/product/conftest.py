"""What product tests share: a result of every kind, and a browser."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.made import make


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small result of every kind, by the names of `EVERY`; made once for all test processes. Nothing is
    written there."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "every"
    folder.mkdir(exist_ok=True)
    make(folder)
    return folder


LOADING_MS = 300_000
"""Most time that a page has to be there: no test is of its speed, and others want the machine."""


def opened(browser: Any, **how: Any) -> Any:
    """A page of its own, with time to load."""
    context = browser.new_context(**how)
    context.set_default_timeout(LOADING_MS)
    context.set_default_navigation_timeout(LOADING_MS)
    return context.new_page()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, as it is installed. No longer than a module: while it is there, this thread has a running event loop,
    beside which others cannot start theirs."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:  # a program of the system, which `.ci/run` installs and a reader's machine may lack
        pytest.skip("needs Chromium (apt-get install chromium), which is not here")
    # not at the top: only where there is a browser; it is among the packages of the tests, so that it is there
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        # a drawing by software through the layer of a card costs a fifth more
        here = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield here
        here.close()
