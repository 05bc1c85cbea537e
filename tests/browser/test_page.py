"""The report's page in a real browser: its figures draw, and what is switched off is gone."""

import os
import shutil

import pandas as pd
import pytest

from symo_exp.report.figures import Figure, Panel
from symo_exp.report.page import page
from symo_exp.report.tables import Table
from symo_exp.report.write import Section

pytestmark = pytest.mark.browser

METHODS = ("node", "symo")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic",
    "--window-size=1400,1000",
)  # fmt: skip


def made() -> str:
    """Figures of two methods, far apart on the page, so that the last waits to be drawn."""
    keys = [(m, "midpoint", "ours") for m in METHODS]
    keys += [(m, "rk4", "published") for m in METHODS] + [("true_ode", "rk4", "floor")]
    rows = pd.DataFrame(
        {"method": method, "integrator": integrator, "source": source, "x": x, "y": y,
         "low": y / 2, "high": 2 * y if source == "ours" else y / 2}
        for i, (method, integrator, source) in enumerate(keys)
        for x, y in ((8.0, 1e-3 / (i + 1)), (16.0, 1e-4 / (i + 1)), (32.0, 1e-5 / (i + 1)))
    )  # fmt: skip
    panel = Panel("test", "n", "error", rows, x_log=True)
    figures = [Figure(f"figure_{i}", f"Figure {i}", "It falls.", [panel, panel]) for i in range(4)]
    table = Table("numbers", "A table", pd.DataFrame({"method": ["NODE"], "error": ["1e-3"]}))
    return page("A report", "From a test.", [Section("all", "All", (), [table], figures)])


@pytest.fixture(scope="module")
def browser():
    """Chromium, or Chrome, with its driver; CI installs them and sets SYMO_EXP_NEEDS_BROWSER."""
    webdriver = pytest.importorskip("selenium.webdriver")
    program = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        if os.environ.get("SYMO_EXP_NEEDS_BROWSER"):
            pytest.fail("no browser: apt-get install chromium chromium-driver")
        pytest.skip("no browser: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield window
    window.quit()


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory):
    file = tmp_path_factory.mktemp("page") / "index.html"
    file.write_text(made(), encoding="utf-8")
    browser.get(file.as_uri())
    wait(browser, lambda: drawn(browser) > 0)
    return browser


def wait(browser, condition):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 60).until(lambda _: condition())


def drawn(browser) -> int:
    return len(browser.find_elements("css selector", ".panel[data-drawn] .main-svg"))


def lines(browser) -> int:
    """Lines that stand in the first panel, bands and marks not counted."""
    script = "return document.querySelector('.panel').querySelectorAll('.js-line').length"
    return browser.execute_script(script)


def click(browser, css: str):
    browser.execute_script("document.querySelector(arguments[0]).click()", css)


def test_figures_draw_when_they_are_come_to_and_nothing_is_complained_of(opened):
    panels = opened.find_elements("css selector", ".panel")
    assert len(panels) == 8
    for panel in panels:
        opened.execute_script("arguments[0].scrollIntoView()", panel)
        wait(opened, lambda panel=panel: panel.get_attribute("data-drawn"))
    assert lines(opened) > 0
    assert "1e-3" in opened.find_element("id", "numbers").text
    assert [e for e in opened.get_log("browser") if e["level"] == "SEVERE"] == []


@pytest.mark.parametrize(
    ("by", "value"), [("method", "node"), ("integrator", "rk4"), ("source", "published")]
)
def test_what_is_switched_off_is_gone_and_comes_back(opened, by, value):
    before = lines(opened)
    box = f"#bar input[data-by='{by}'][data-value='{value}']"
    click(opened, box)
    wait(opened, lambda: lines(opened) < before)
    click(opened, box)
    wait(opened, lambda: lines(opened) == before)


def test_axes_change_between_logarithmic_and_linear(opened):
    kind = "return document.querySelector('.panel').layout[arguments[0]].type"
    for letter in ("x", "y"):
        axis = f"{letter}axis"
        assert opened.execute_script(kind, axis) == "log"
        click(opened, f".axes button[data-axis='{letter}']")
        wait(opened, lambda axis=axis: opened.execute_script(kind, axis) == "linear")
        click(opened, f".axes button[data-axis='{letter}']")
        wait(opened, lambda axis=axis: opened.execute_script(kind, axis) == "log")
