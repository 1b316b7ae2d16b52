"""A headless Chromium and a made-up site for the tests of the pages. Without Chromium they skip, in CI they fail."""

import os
import shutil
from pathlib import Path

import pytest
from synthetic import HOSTILE, Run, make_run, toy_models

from brdfatlas.models import MODELS

#: No network, software GL: the pages must need neither network nor a graphics card.
ARGUMENTS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]


@pytest.fixture(scope="session")
def browser():
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        if os.environ.get("CI") == "true":
            pytest.fail("no Chromium: `make test` installs it where it may (Debian package chromium)")
        pytest.skip("no Chromium on this machine (Debian package chromium)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield launched
        launched.close()


class Tab:
    """A page with everything that went wrong in it."""

    def __init__(self, context):
        self.page = context.new_page()
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        self.page.on("requestfailed", self._missing)
        self.page.on("request", self._local)
        self.page.on("console", self._console)

    def _missing(self, request) -> None:
        # What a page had asked for when the test left it is aborted, not missing.
        if request.failure != "net::ERR_ABORTED":
            self.faults.append(f"missing: {request.url} ({request.failure})")

    def _local(self, request) -> None:
        if not request.url.startswith(("file:", "data:", "blob:")):
            self.faults.append(f"network: {request.url}")

    def _console(self, message) -> None:
        # Tests read the canvas back, which the page never does; Chromium's advice on that is not the page's fault.
        if message.type in ("error", "warning") and "willReadFrequently" not in message.text:
            self.faults.append(f"console {message.type}: {message.text}")

    def open(self, path: Path, fragment: str = ""):
        self.page.goto(path.as_uri() + fragment)
        self.page.wait_for_load_state("load")
        return self.page


@pytest.fixture
def tab(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    yield Tab(context)
    context.close()


@pytest.fixture(scope="package")
def site(tmp_path_factory) -> Run:
    """Five materials with hostile titles, seven models of which one failed once, two scenes; every page written."""
    root = tmp_path_factory.mktemp("site")
    materials = ["alum-bronze", "pink-felt", "chrome", "yellow-plastic", "pvc"]
    with MODELS.restored():
        models = toy_models(root / "toys", 7)
        run = make_run(root, materials, models, failed=("chrome", "toy_03"), title=HOSTILE, size=48)
        run.write_site()
    return run  # the models are unknown again: other files' tests may follow in this process
