"""One browser and one small report for all tests of the pages."""

import os
import shutil

import pytest
from msgspec.structs import replace

from crosscheck.report import write_report
from tests.browser.pages_making import write_all
from tests.report_making import ADVICE, CHANGES, small_results

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="session")
def browser():
    """The system's Chromium; without it the tests are skipped, if skips are allowed."""
    reason = None if BROWSER else "no Chromium on this machine (Debian, Ubuntu: apt-get install chromium)"
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        reason = str(error)
    if reason:
        (pytest.fail if os.environ.get("CROSSCHECK_NO_SKIP") == "1" else pytest.skip)(reason)
    with sync_playwright() as driver:
        # Without a zygote its processes keep the priority of the tests: on a busy machine pages take half the time.
        running = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--no-zygote"])
        yield running
        running.close()


@pytest.fixture(scope="session")
def document():
    """What the report is written from."""
    return replace(small_results(), changes=CHANGES, advice=ADVICE)


@pytest.fixture(scope="session")
def site(document, tmp_path_factory):
    """Folder of the report."""
    folder = tmp_path_factory.mktemp("site") / "report"
    write_report(document, folder)
    return folder


@pytest.fixture(scope="session")
def home(site):
    """The folder of the report, with a page of every other kind beside it."""
    write_all(site.parent)
    return site.parent


class Watched:
    """A page that records its errors and its requests to a network."""

    def __init__(self, context, folder):
        self.page, self.folder = context.new_page(), folder
        self.complaints, self.errors_as = [], []
        context.set_default_timeout(180_000)  # a crowded machine is slow, not wrong
        self.page.on("console", lambda each: self.complaints.append(each.text) if each.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: None if request.url.startswith(("file:", "data:", "blob:"))
                     else self.errors_as.append(request.url))

    def open(self, name):
        """Load a page of the report from disk; returns the Playwright page."""
        self.page.goto(self.folder.as_uri() + "/" + name)
        return self.page

    def assert_accessible(self):
        """Axe finds nothing on the open page."""
        from axe_playwright_python.sync_playwright import Axe

        found = Axe().run(self.page, options={"preload": False})  # it would ask for the style sheet a second time
        assert found.violations_count == 0, found.generate_report()


@pytest.fixture
def pages(site):
    """The folder whose pages `watched` opens; a module may have another."""
    return site


@pytest.fixture
def watched(browser, pages, request):
    """Opens pages; whatever a test does, no page may report an error or ask a network for anything.

    By an indirect parameter: width and colour scheme, or options of the browser's context.
    """
    given = getattr(request, "param", {})
    if isinstance(given, tuple):
        given = {"viewport": {"width": given[0], "height": 900}, "color_scheme": given[1]}
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, "accept_downloads": True, **given})
    watched = Watched(context, pages)
    yield watched
    context.close()
    assert watched.complaints == []
    assert watched.errors_as == []
