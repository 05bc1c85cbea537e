"""The page of the report in a browser, at the widths of a desktop and of a phone."""

import os
import re
import shutil

import pandas as pd
import pytest

from symo_exp.report.__main__ import general_report
from symo_exp.report.document import Report, Section
from symo_exp.report.page import html
from symo_exp.report.runs import tidy
from symo_exp.report.tables import ResultTable
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
    rows.append(row(status="FAILED", reason="out of memory " * 40, experiment="mine", seed=7))
    return html(general_report(tidy(rows), "From a test."))


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


def charts(browser):
    """All charts that are shown, each drawn."""
    found = [c for c in browser.find_elements("css selector", ".chart") if c.is_displayed()]
    for chart in found:
        browser.execute_script("arguments[0].scrollIntoView()", chart)
        wait(browser, lambda chart=chart: chart.get_attribute("data-drawn"))
    return found


def lines(browser) -> int:
    """Lines of the first chart, without bands and markers."""
    return len(charts(browser)[0].find_elements("css selector", ".mark-line path"))


def labels(browser) -> list[str]:
    """The labels of the axes of the first chart."""
    found = charts(browser)[0].find_elements("css selector", ".role-axis-label text")
    return sorted(label.text for label in found)


def click(browser, css: str):
    browser.execute_script("document.querySelector(arguments[0]).click()", css)


def box_of(browser, css: str) -> dict:
    script = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
    return browser.execute_script(script, css)


def test_charts_are_drawn_without_an_error(opened):
    assert len(charts(opened)) > 4
    assert lines(opened) > 0
    legend = charts(opened)[0].find_elements("css selector", ".role-legend-label text")
    names = {text.text.removeprefix("☑ ") for text in legend}
    assert {"NODE", "SyMo", "true system, explicit", "RK4", "midpoint"} <= names
    assert [e for e in opened.get_log("browser") if e["level"] == "SEVERE"] == []


def test_no_panel_is_cut_on_a_phone(browser, address):
    look_at(browser, address, 390)
    for chart in charts(browser):
        drawn = chart.find_element("css selector", ".view svg").rect
        assert drawn["x"] >= 0
        assert drawn["x"] + drawn["width"] <= 390


@pytest.mark.parametrize("width", [1600, 390])
def test_the_first_screen_has_the_answer_and_nothing_is_wider_than_the_window(
    width, browser, address
):
    look_at(browser, address, width)
    assert "SyMo has the smallest test error" in browser.find_element("id", "answer").text
    first = box_of(browser, "#answer li:last-of-type")
    assert first["bottom"] < 1000
    assert box_of(browser, "#table_best_cartpole")["top"] < 1000
    assert box_of(browser, "#bar")["height"] <= 60
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert not browser.find_element("id", "table_unfinished").is_displayed()


@pytest.mark.parametrize("width", [1600, 390])
def test_the_target_of_a_link_is_not_under_the_bar(width, browser, address):
    look_at(browser, f"{address}#noise", width)
    bar, section = box_of(browser, "#bar"), box_of(browser, "#noise")
    assert bar["top"] == 0
    assert section["top"] >= bar["bottom"]
    look_at(browser, f"{address}#table_accuracy", width)  # a table that is folded
    wait(browser, browser.find_element("id", "table_accuracy").is_displayed)


def test_the_first_column_stays_when_a_table_scrolls(browser, address):
    look_at(browser, f"{address}#table_accuracy", 390)
    cell = "#table_accuracy td"
    before = box_of(browser, cell)
    script = "document.querySelector('#table_accuracy').parentElement.scrollLeft = 150"
    browser.execute_script(script)
    assert box_of(browser, cell)["left"] == pytest.approx(before["left"], abs=1)
    assert box_of(browser, "#table_accuracy td:nth-child(2)")["left"] < before["right"]


@pytest.mark.parametrize("width", [1600, 390])
def test_a_long_path_does_not_widen_the_page(width, browser, tmp_path):
    path = "/a_folder" * 40
    table = ResultTable("mine", path, pd.DataFrame({"a": [path], "b": ["1"]}), [path])
    parts = [Section(key, path, [path], [table]) for key in ("first", "second")]
    file = tmp_path / "index.html"
    file.write_text(html(Report(path, path, parts, pd.DataFrame())), encoding="utf-8")
    look_at(browser, file.as_uri(), width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("width", [1600, 390])
def test_long_text_of_a_table_is_wrapped(width, browser, address):
    look_at(browser, f"{address}#table_unfinished", width)
    wait(browser, browser.find_element("id", "table_unfinished").is_displayed)
    script = "return [...document.querySelectorAll('td')].map((c) => c.offsetWidth)"
    assert max(browser.execute_script(script)) < 600


def test_cells_of_a_heat_map_do_not_hide_the_shadow_at_a_cut_side(opened):
    script = """return [...document.querySelectorAll('.heat td[style]')].map(
        (cell) => getComputedStyle(cell).backgroundColor)"""
    fills = opened.execute_script(script)
    assert fills
    assert all(re.search(r"/ 0[.\d]*\)$", fill) for fill in fills)


@pytest.mark.parametrize("name", ["NODE", "RK4", "floor"])
def test_the_menu_hides_and_shows_series(opened, name):
    before = lines(opened)
    for wanted in (False, True):
        click(opened, f"#bar input[value='{name}']")
        wait(opened, lambda wanted=wanted: (lines(opened) == before) == wanted)


def test_a_name_of_the_legend_switches_its_series_in_all_charts(opened):
    before, last = lines(opened), charts(opened)[-1]
    label = last.find_element("css selector", ".role-legend-label text")
    assert label.text == "☑ NODE"
    label.click()
    wait(opened, lambda: lines(opened) < before)
    assert not opened.find_element("css selector", "#bar input[value='NODE']").is_selected()
    assert last.find_element("css selector", ".role-legend-label text").text == "☐ NODE"


def test_one_system_is_shown_alone(opened):
    titles = "return [...document.querySelectorAll('.role-title-text')].map((t) => t.textContent)"
    charts(opened)
    assert any("pendulum" in title for title in opened.execute_script(titles))
    opened.execute_script(
        "const s = document.getElementById('system'); s.value = 'cartpole';"
        "s.dispatchEvent(new Event('change'))"
    )
    shown = charts(opened)
    assert {"cartpole" in one.get_attribute("data-systems") for one in shown} == {True}
    wait(opened, lambda: not any("pendulum" in t for t in opened.execute_script(titles)))
    assert not opened.find_element("id", "table_best_pendulum").is_displayed()


def test_a_tooltip_shows_the_value_with_its_unit(opened):
    from selenium.webdriver import ActionChains

    click(opened, "#bar input[value='NODE']")
    chart = charts(opened)[0]
    opened.execute_script("arguments[0].scrollIntoView()", chart)
    marks = [m for m in chart.find_elements("css selector", ".mark-symbol.role-mark path")
             if "SyMo" in (m.get_attribute("aria-label") or "")]  # fmt: skip
    ActionChains(opened).move_to_element(marks[0]).perform()
    wait(opened, lambda: opened.find_elements("css selector", "#vg-tooltip-element.visible"))
    told = opened.find_element("id", "vg-tooltip-element").text.splitlines()
    assert told[:3] == [
        "SyMo, midpoint", "test MSE [m², rad²] 1.66e-6", "training trajectories 8",
    ]  # fmt: skip


def test_axes_change_between_logarithmic_and_linear(opened):
    before = labels(opened)
    button = ".axes button[value='y']"
    click(opened, button)
    wait(opened, lambda: labels(opened) != before)
    click(opened, button)
    wait(opened, lambda: labels(opened) == before)


def test_a_chart_moves_and_zooms_and_a_double_click_resets_it(opened):
    from selenium.webdriver import ActionChains

    before = labels(opened)
    place = charts(opened)[0].find_element("css selector", ".mark-group.role-scope .background")
    ActionChains(opened).drag_and_drop_by_offset(place, 60, 40).perform()
    wait(opened, lambda: labels(opened) != before)
    ActionChains(opened).double_click(place).perform()
    wait(opened, lambda: labels(opened) == before)


@pytest.mark.parametrize(("light", "darker"), [("light", "ink"), ("dark", "paper")])
def test_the_page_follows_the_light_or_dark_setting(light, darker, browser, address):
    look_at(browser, address, 1600, light=light)
    script = """const style = getComputedStyle(document.body);
    return [style.color, style.backgroundColor].map((c) => Number(c.match(/\\d+/)[0]))"""
    ink, paper = browser.execute_script(script)
    assert abs(ink - paper) > 150
    assert (ink < paper) == (darker == "ink")
    fill = charts(browser)[0].find_element("css selector", ".role-axis-title text")
    before = fill.get_attribute("fill")
    assert (int(before[1:3], 16) < 128) == (darker == "ink")
    click(browser, "#theme")
    wait(browser, lambda: _fill(browser) not in ("", before))


def test_paper_is_light_and_has_the_folded_tables(browser, address):
    look_at(browser, address, 1600, light="dark")
    charts(browser)
    try:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        browser.execute_script("dispatchEvent(new Event('beforeprint'))")
        script = """return [document.body, ...document.querySelectorAll('.view .mark-text text')]
        .map((one) => getComputedStyle(one)).map((style) => [style.color, style.fill])"""
        (ink, _), *texts = browser.execute_script(script)
        assert sum(map(int, re.findall(r"\d+", ink))) < 200
        assert {fill for _, fill in texts} == {ink}
        assert browser.find_element("id", "table_unfinished").is_displayed()
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_numbers_and_names_are_not_cut_on_paper(browser, tmp_path):
    """Beside a long note, which takes the width that it can have."""
    lines = [["theta.viscous_friction", "0.0566", 20 * "a long note "]]
    table = ResultTable("t", "", pd.DataFrame(lines, columns=["parameter", "value", "note"]))
    parts = [Section("one", "One", tables=[table])]
    file = tmp_path / "index.html"
    file.write_text(html(Report("", "", parts, pd.DataFrame())), encoding="utf-8")
    look_at(browser, file.as_uri(), 390)
    try:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        name, number, note = (
            browser.execute_script(
                """const range = document.createRange();
                range.selectNodeContents(arguments[0]);
                return new Set([...range.getClientRects()].map((one) => one.top)).size""",
                cell,
            )
            for cell in browser.find_elements("css selector", "td")
        )
        assert (name, number) == (1, 1)
        assert note > 1
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_a_page_without_charts_changes_between_light_and_dark(browser, tmp_path):
    file = tmp_path / "index.html"
    one = [row(system="pendulum", experiment="mine")]
    file.write_text(html(general_report(tidy(one), "From a test.")), encoding="utf-8")
    look_at(browser, file.as_uri(), 1600)
    script = "return getComputedStyle(document.body).backgroundColor"
    before = browser.execute_script(script)
    click(browser, "#theme")
    assert browser.execute_script(script) != before


def _fill(browser) -> str:
    found = browser.find_elements("css selector", ".role-axis-title text")
    return found[0].get_attribute("fill") if found else ""


def test_the_page_of_400_runs_is_small():
    rows = [
        row(dict.fromkeys(MEASURES, 1.0 + seed), method=method, n_traj=n, seed=seed, system=s)
        for method in ("node", "l_node", "symo", "e2e_symo") for n in (8, 16, 32, 64, 128)
        for s in ("pendulum", "cartpole", "acrobot", "arm") for seed in range(5)
    ]  # fmt: skip
    assert len(rows) == 400
    assert len(html(general_report(tidy(rows), ""))) < 1_300_000
