"""The report's page in a real browser, on a desk and on a phone."""

import os
import shutil
import time

import pytest

from symo_exp.report.__main__ import report
from symo_exp.report.page import page
from symo_exp.report.runs import tidy
from tests.report.stores import MEASURES, row

pytestmark = pytest.mark.browser

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic",
    "--window-size=1400,1000",
)  # fmt: skip


def made() -> str:
    """Runs of two methods on two systems, with noise, so that there is every kind of section."""
    value = {"node": 1e-4, "symo": 8.85e-6, "true_ode": 1e-9}
    rows = [
        row({"test_mse": value[method] / n * (1 + seed), "integration_mse": 2.0 * (1 + seed),
             "training_seconds": 30.0 + n},
            method=method, integrator=integrator, n_traj=n, noise_std=noise, seed=seed,
            system=system, experiment="mine")
        for method, integrator in (("node", "rk4"), ("symo", "midpoint"), ("true_ode", "rk4"))
        for system in ("pendulum", "cartpole") for n in (8, 16, 32) for noise in (0.0, 0.01)
        for seed in (0, 1)
    ]  # fmt: skip
    rows.append(row(status="FAILED", reason="out of memory", experiment="mine", seed=7))
    return page(report(tidy(rows), "From a test."))


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
def address(tmp_path_factory) -> str:
    file = tmp_path_factory.mktemp("page") / "index.html"
    file.write_text(made(), encoding="utf-8")
    return file.as_uri()


@pytest.fixture
def opened(browser, address):
    look_at(browser, address, 1600)
    return browser


def look_at(browser, address, width, height=1000, light="light"):
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    light = {"name": "prefers-color-scheme", "value": light}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [light]})
    browser.get("about:blank")  # else the same address would keep what was clicked
    browser.get(address)


def wait(browser, condition):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 60).until(lambda _: condition())


def panels(browser):
    """All panels, each drawn."""
    found = [p for p in browser.find_elements("css selector", ".panel") if p.is_displayed()]
    for panel in found:
        browser.execute_script("arguments[0].scrollIntoView()", panel)
        wait(browser, lambda panel=panel: panel.get_attribute("data-drawn"))
    return found


def lines(browser) -> int:
    """Lines that stand in the first panel, bands and marks not counted."""
    return len(panels(browser)[0].find_elements("css selector", ".line"))


def click(browser, css: str):
    browser.execute_script("document.querySelector(arguments[0]).click()", css)


def box_of(browser, css: str) -> dict:
    script = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
    return browser.execute_script(script, css)


def test_figures_draw_when_they_are_come_to_and_nothing_is_complained_of(opened):
    assert len(panels(opened)) > 8
    assert lines(opened) > 0
    legend = opened.find_element("css selector", ".chart .legend").text
    assert {"NODE, RK4", "SyMo, midpoint", "true system, explicit, RK4"} <= {*legend.split("\n")}
    assert [e for e in opened.get_log("browser") if e["level"] == "SEVERE"] == []


@pytest.mark.parametrize("width", [1600, 390])
def test_the_first_screen_has_the_answer_and_nothing_is_wider_than_the_window(
    width, browser, address
):
    look_at(browser, address, width)
    assert "SyMo has the smallest test error" in browser.find_element("id", "answer").text
    first = box_of(browser, "#answer li:last-of-type")
    assert first["bottom"] < 1000
    assert box_of(browser, "#best_cartpole")["top"] < 1000
    assert box_of(browser, "#bar")["height"] <= 60
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert not browser.find_element("id", "unfinished").is_displayed()


@pytest.mark.parametrize("width", [1600, 390])
def test_what_a_link_leads_to_is_not_under_the_bar(width, browser, address):
    look_at(browser, f"{address}#noise", width)
    bar, section = box_of(browser, "#bar"), box_of(browser, "#noise")
    assert bar["top"] == 0
    assert section["top"] >= bar["bottom"]
    look_at(browser, f"{address}#accuracy", width)  # a table that is folded
    wait(browser, browser.find_element("id", "accuracy").is_displayed)


def test_the_first_column_stays_when_a_table_scrolls(browser, address):
    look_at(browser, f"{address}#accuracy", 390)
    cell = "#accuracy td"
    before = box_of(browser, cell)
    browser.execute_script("document.querySelector('#accuracy').parentElement.scrollLeft = 150")
    assert box_of(browser, cell)["left"] == pytest.approx(before["left"], abs=1)
    assert box_of(browser, "#accuracy td:nth-child(2)")["left"] < before["right"]


@pytest.mark.parametrize(
    ("by", "value"), [("method", "node"), ("integrator", "rk4"), ("source", "floor")]
)
def test_what_is_switched_off_is_gone_and_comes_back(opened, by, value):
    before = lines(opened)
    box = f"#bar input[data-by='{by}'][data-value='{value}']"
    click(opened, box)
    assert lines(opened) < before
    click(opened, box)
    assert lines(opened) == before


def test_one_system_is_shown_alone(opened):
    before = len(panels(opened))
    opened.execute_script(
        "const s = document.getElementById('system'); s.value = 'cartpole';"
        "s.dispatchEvent(new Event('change'))"
    )
    shown = panels(opened)
    assert len(shown) == before / 2
    assert {panel.get_attribute("data-system") for panel in shown} == {"cartpole"}
    assert not opened.find_element("id", "best_pendulum").is_displayed()


def test_hover_says_the_number_with_its_unit(opened):
    panel = panels(opened)[0]  # the test error
    opened.execute_script(
        """const marks = [...arguments[0].querySelectorAll("g path[transform]")];
        const symo = marks.find((one) => one.style.fill === "rgb(0, 114, 178)");
        const box = symo.getBoundingClientRect();
        const at = {clientX: box.x + box.width / 2, clientY: box.y + box.height / 2};
        arguments[0].dispatchEvent(new PointerEvent("pointermove", at))""",
        panel,
    )
    told = opened.find_element("id", "tip").text.splitlines()
    assert told[:3] == [
        "SyMo, midpoint",
        "test MSE = 1.66e-6 m², rad²",
        "training trajectories = 8",
    ]


def test_axes_change_between_logarithmic_and_linear(opened):
    marks = "return arguments[0].querySelectorAll('text tspan').length"  # powers of ten
    panel = panels(opened)[0]
    assert opened.execute_script(marks, panel) > 0
    click(opened, ".axes button[data-axis='1']")
    assert opened.execute_script(marks, panel) == 0
    click(opened, ".axes button[data-axis='1']")
    assert opened.execute_script(marks, panel) > 0


def test_a_rectangle_is_enlarged_and_a_double_click_undoes_it(opened):
    panel = panels(opened)[0]
    script = """const box = arguments[0].getBoundingClientRect();
    for (const [kind, x, y] of [["pointerdown", 0.3, 0.3], ["pointerup", 0.6, 0.6]])
      arguments[0].dispatchEvent(new PointerEvent(kind, {pointerType: "mouse",
        clientX: box.x + x * box.width, clientY: box.y + y * box.height}));
    return [...arguments[0].querySelectorAll("text")].map((one) => one.textContent).join()"""
    words = "return [...arguments[0].querySelectorAll('text')].map((one) => one.textContent).join()"
    before = opened.execute_script(words, panel)
    assert opened.execute_script(script, panel) != before
    opened.execute_script("arguments[0].dispatchEvent(new MouseEvent('dblclick'))", panel)
    assert opened.execute_script(words, panel) == before


@pytest.mark.parametrize(("light", "darker"), [("light", "ink"), ("dark", "paper")])
def test_light_and_dark(light, darker, browser, address):
    look_at(browser, address, 1600, light=light)
    script = """const style = getComputedStyle(document.body);
    return [style.color, style.backgroundColor].map((c) => Number(c.match(/\\d+/)[0]))"""
    ink, paper = browser.execute_script(script)
    assert abs(ink - paper) > 150
    assert (ink < paper) == (darker == "ink")


def test_the_page_of_400_runs_is_small():
    rows = [
        row(dict.fromkeys(MEASURES, 1.0 + seed), method=method, n_traj=n, seed=seed, system=s)
        for method in ("node", "l_node", "symo", "e2e_symo") for n in (8, 16, 32, 64, 128)
        for s in ("pendulum", "cartpole", "acrobot", "arm") for seed in range(5)
    ]  # fmt: skip
    assert len(rows) == 400
    start = time.process_time()
    assert len(page(report(tidy(rows), ""))) < 500_000
    assert time.process_time() - start < 5
