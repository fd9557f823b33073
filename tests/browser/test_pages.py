"""The interactive pages in a real browser: nothing leaves, nothing fails, zoom and keys work, axe finds nothing.

`make test-browser` runs them; elsewhere they are skipped where Playwright or Chromium is not there.
"""

import datetime
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import valvesim as vs
from valvesim.characterisation.response_set import measure_responses
from valvesim.characterisation.spectral_response import own_response
from valvesim.characterisation.thermal_drift import static_drift
from valvesim.reports import run as run_page
from valvesim.reports.chart import Chart, Charts, Series
from valvesim.reports.html_page import section, write_html
from valvesim.reports.response import response_report
from valvesim.reports.title_block import TitleBlock

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
DAY = datetime.date(2026, 1, 2)
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), "")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync"]  # fmt: skip
PAGES = ("run", "responses", "diagnosis", "records", "lines")
READY = "document.documentElement.dataset.ready === 'yes'"
PICTURES = Path(os.environ.get("VALVESIM_SCREENSHOTS", "")) if os.environ.get("VALVESIM_SCREENSHOTS") else None


@pytest.fixture(scope="module")
def browser():
    required = os.environ.get("VALVESIM_BROWSER") == "required"
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        if required:
            raise
        pytest.skip("playwright is not installed")
    if not CHROMIUM:
        assert not required, "no Chromium found: apt-get install chromium, or CHROMIUM=path"
        pytest.skip("Chromium is not installed")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def visit(browser):
    """Open a page; at the end nothing may have failed there, nor been asked of a network."""
    seen, pages = [], []

    def visit(path, width=1200, scheme="light"):
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page.on("console", lambda message: seen.append(message.text))
        page.on("pageerror", lambda error: seen.append(str(error)))
        page.on("request", lambda request: request.url.startswith(("data:", path.as_uri())) or seen.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_function(READY)
        pages.append(page)
        return page

    yield visit
    for page in pages:
        page.close()
    assert not seen


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def run(folder):
    """The page of a run that warms while its frequency goes: every section that a run may have."""
    case = vs.Scenario(
        title="Warm <sweep>", duration="1.2 s", output_rate="4 kHz", oil_temperature=vs.Ramp(end_value=80.0, rate=60.0),
        command=vs.Chirp(amplitude="1 mA", start_frequency="5 Hz", end_frequency="300 Hz", duration="1 s"),
    )  # fmt: skip
    result = vs.simulate(case)
    response = own_response(result)
    pictures = [run_page.picture_sweep(result, response, DAY, folder / "sweep.png")]
    return run_page.page_run(result, pictures, DAY, folder / "run.html", static_drift(result), response)


@pytest.fixture(scope="module")
def responses(folder):
    sets = measure_responses(vs.Valve(), sweeps=(0.25, 1.0), frequencies=(10.0, 30.0, 100.0, 200.0, 300.0), chirp=False)
    return response_report(sets, folder, valve="reference valve", date=DAY)[-1]


@pytest.fixture(scope="module")
def lines(folder):
    """A page of lines that are known: a ramp of seconds, one with gaps, one over a logarithmic axis."""
    x = np.linspace(0.0, 10.0, 2001)
    gaps = np.where((x > 4.0) & (x < 5.0), np.nan, 100.0 - x)
    two = [Chart(name, x, [Series("ramp", "mm", x / 10.0, 1e-3), Series("gaps", "bar", gaps)], group="a")
           for name in ("First", "Second")]  # fmt: skip
    f = np.geomspace(1.0, 1000.0, 50)
    bode = Chart("Bode", f, [Series("ratio", "dB", -f / 100.0)], "frequency", "Hz", log_x=True)
    block = TitleBlock(title="Lines", valve="none", date=DAY)
    parts = (section("Known", Charts([*two, bode])), section("Empty", Charts([])))
    return write_html(folder / "lines.html", block, parts)


@pytest.fixture(scope="module")
def diagnosis(folder):
    """The page of a diagnosis that has everything."""
    from test_report_diagnosis import ambiguous, write_report

    return write_report(ambiguous(), folder / "diagnosis")[-1]


@pytest.fixture(scope="module")
def records(folder):
    """Two records side by side, one with a gap."""
    from valvesim.measurement.survey import all_channels
    from valvesim.reports.records import page_recordings

    rng, recordings = np.random.default_rng(1), []
    for name, n in (("first", 2000), ("second <b>", 3000)):
        rows = [f"{k / 1000},{5 * np.sin(k / 100):.6g},{0.1 * np.sin(k / 100) + 1e-3 * rng.normal():.6g}\n"
                for k in range(n) if name == "first" or not 1000 < k < 1200]  # fmt: skip
        (folder / f"{name}.csv").write_text("time [s],current [mA],spool_position [mm]\n" + "".join(rows))
        recordings.append(all_channels([folder / f"{name}.csv"]).recording)
    return page_recordings(recordings, DAY, folder / "records.html")


def scale(page, chart):
    return page.evaluate(f"(() => {{ const s = valvesimCharts[{chart}].plot.scales.x; return [s.min, s.max]; }})()")


def accessible(page):
    """No violation of the rules of axe."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    found = axe.run(page)
    assert found.violations_count == 0, found.generate_report()


def test_numbers_arrive_as_they_were(visit, lines):
    page = visit(lines)
    data = page.evaluate("valvesimCharts.map((one) => one.plot.data.map((column) => Array.from(column)))")
    x, ramp, gaps = (np.array(column, dtype=float) for column in data[0])
    assert x == pytest.approx(np.linspace(0.0, 10.0, 2001)) and ramp == pytest.approx(x / 10.0, abs=1e-7)
    assert np.isnan(gaps).sum() == 199 and np.nanmax(np.abs(gaps - (100.0 - x))) < 1e-5
    assert len(data) == 3 and data[2][0][0] == pytest.approx(1.0) and data[2][0][-1] == pytest.approx(1000.0)


def test_dragging_zooms_the_whole_group_and_a_double_click_shows_all(visit, lines):
    page = visit(lines)
    box = page.locator(".u-over").first.bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 40, steps=5)
    page.mouse.up()
    for chart in (0, 1):
        assert scale(page, chart) == pytest.approx([2.5, 7.5], abs=0.05)
    assert scale(page, 2) == pytest.approx([1.0, 1000.0])
    page.mouse.dblclick(box["x"] + 50, box["y"] + 50)
    for chart in (0, 1):
        assert scale(page, chart) == pytest.approx([0.0, 10.0])


def test_keys_move_the_cursor_and_tell_its_values_aloud(visit, lines):
    page = visit(lines)
    first = page.locator(".plot").first
    first.focus()
    page.keyboard.press("ArrowRight")
    spoken = page.locator(".spoken").first.text_content()
    assert spoken.startswith("time 5.050 s: ramp 0.505 mm, gaps 94.95")
    page.keyboard.press("+")
    low, high = scale(page, 0)
    assert high - low == pytest.approx(5.0) and low < 5.05 < high and scale(page, 1) == [low, high]
    page.keyboard.press("Shift+ArrowRight")
    assert scale(page, 0)[0] == pytest.approx(low + 1.25, abs=1e-6)
    page.keyboard.press("0")
    assert scale(page, 0) == pytest.approx([0.0, 10.0])
    page.keyboard.press("-")
    assert scale(page, 0) == pytest.approx([0.0, 10.0])  # never beyond the data


def test_buttons_zoom_and_a_channel_is_switched_off_by_keyboard(visit, lines):
    page = visit(lines)
    page.get_by_role("button", name="Zoom in: Bode").click()
    low, high = scale(page, 2)
    assert high / low == pytest.approx(10.0**1.5, rel=1e-3)  # half of three decades
    box = page.get_by_role("checkbox", name="ramp").first
    box.focus()
    page.keyboard.press("Space")
    assert page.evaluate("valvesimCharts[0].plot.series.map((one) => one.show)") == [True, False, True]
    first = page.locator(".plot").first
    first.focus()
    page.keyboard.press("ArrowRight")
    assert "ramp" not in page.locator(".spoken").first.text_content()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_accessible_in_light_and_dark(visit, request, name, scheme):
    page = visit(request.getfixturevalue(name), scheme=scheme)
    accessible(page)
    page.get_by_role("button", name="Light or dark page").click()
    accessible(page)
    if PICTURES:
        page.screenshot(path=PICTURES / f"{name}_{scheme}.png", full_page=True)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_a_telephone_and_charts_follow_the_window(visit, request, name):
    page = visit(request.getfixturevalue(name), width=390)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    accessible(page)
    page.set_viewport_size({"width": 1000, "height": 900})
    page.wait_for_function("valvesimCharts[0].plot.width > 450")
    if PICTURES:
        page.set_viewport_size({"width": 390, "height": 900})
        page.wait_for_function("valvesimCharts[0].plot.width < 390")
        page.screenshot(path=PICTURES / f"{name}_390.png", full_page=True)


def test_a_page_prints_light_and_without_its_buttons(visit, run, folder):
    page = visit(run, scheme="dark")
    page.emulate_media(media="print", color_scheme="dark")
    assert not page.locator(".tools").first.is_visible() and not page.locator("nav").is_visible()
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert len(page.pdf(format="A4")) > 50_000


def test_a_page_says_what_it_is_of_and_made_by_what(visit, run):
    page = visit(run)
    assert page.title() == "Warm <sweep>" and page.locator("h1").text_content() == "Warm <sweep>"
    words = page.locator("footer").text_content()
    assert all(text in words for text in ("valvesim", "2026-01-02", "5e-05", "mil_prf_5606", "reference valve"))
    for link in page.locator("nav a").all():
        assert page.locator(link.get_attribute("href")).count() == 1
    assert page.locator("figure.chart").count() == 6 + 2 + 3


def test_records_side_by_side_move_together(visit, records):
    page = visit(records)
    assert page.locator(".charts.beside figure.chart").count() == 4
    page.get_by_role("button", name="Zoom in: current, first.csv").click()
    assert scale(page, 0) == scale(page, 1) == scale(page, 3) and scale(page, 0)[1] < 1.9


def test_a_zoom_and_back_leaves_the_very_picture(visit, lines):
    page = visit(lines)
    chart = page.locator("figure.chart canvas").first
    before = chart.screenshot()
    page.get_by_role("button", name="Zoom in: First").click()
    inside = chart.screenshot()
    page.get_by_role("button", name="Show the whole: First").click()
    assert chart.screenshot() == before != inside


def test_the_charts_draw_something_in_each_colour(visit, lines):
    page = visit(lines)
    found = page.evaluate(
        """[0, 1].map((k) => { const c = valvesimCharts[k].plot.ctx;
        const d = c.getImageData(0, 0, c.canvas.width, c.canvas.height).data;
        let blue = 0, red = 0; for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 200) {
        blue += d[i + 2] > d[i] + 60; red += d[i] > d[i + 2] + 60; } return [blue, red]; })"""
    )
    assert all(blue > 300 and red > 200 for blue, red in found)
