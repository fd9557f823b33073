"""The pictures of a run: they are made, show what they should, and thin long lines without losing their extremes."""

import base64
import datetime
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from picture_texts import check_texts, tick_labels

import valvesim as vs
from valvesim.characterisation.rest_characteristic import rest_characteristic
from valvesim.characterisation.thermal_drift import nominal, observed_drift, static_drift
from valvesim.errors import InputError
from valvesim.reports import run as report
from valvesim.reports.chart import MOST_CHART_POINTS, Chart, Charts, Series, thinned
from valvesim.reports.html_page import page, section
from valvesim.reports.plotting import MOST_POINTS, Figure, label_decades, swings, thin
from valvesim.reports.run_table import figure_text
from valvesim.reports.title_block import TitleBlock, package_version, valve_name

DAY = datetime.date(2026, 1, 2)
ISOTHERMAL = vs.Thermal(network=None)


def run(**changes):
    standard = {
        "duration": 0.4,
        "thermal": ISOTHERMAL,
        "command": vs.Sine(amplitude=1e-3, frequency=20.0),
        "title": "T",
    }
    return vs.simulate(vs.Scenario(**(standard | changes)))


@pytest.fixture(scope="module")
def warm():
    return run(oil_temperature=vs.Ramp(start_value=20.0, end_value=100.0, rate=200.0))


def size(path):
    """(width, height) of a PNG file from its header, with some contrast inside."""
    from matplotlib.image import imread

    pixels = imread(path)
    assert path.read_bytes().startswith(b"\x89PNG\r\n") and np.ptp(pixels[..., :3]) > 0.5
    return pixels.shape[1], pixels.shape[0]


def pictures(result, folder):
    drift, observed = static_drift(result), observed_drift(result, vs.simulate(nominal(result.scenario)))
    rest = rest_characteristic(result.scenario)
    return (
        report.picture_run(result, DAY, folder / "run.png"),
        report.picture_characteristic(result, rest, DAY, folder / "characteristic.png"),
        report.picture_drift(drift, observed, result.scenario, DAY, folder / "drift.png"),
    )


def test_every_picture_of_a_warm_run_is_made(warm, tmp_path):
    for path in pictures(warm, tmp_path / "new folder"):
        width, height = size(path)
        assert width >= 1000 and height >= 500 and path.stat().st_size > 20_000


def lines(figure, panel):
    """Each line of a panel (found by the start of its label of y) as (x, y)."""
    (axes,) = (axes for axes in figure.axes if axes.get_ylabel().startswith(panel))
    return [line.get_data() for line in axes.lines]


def test_the_picture_of_a_run_shows_its_channels_in_readable_units(warm):
    figure = report.draw_run(warm)
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
    assert labels == [
        "command [mA]", "temperature [°C]", "armature angle [mrad]", "nozzle pressures [bar]", "spool position [mm]",
        "flow [L/min]",
    ]  # fmt: skip
    ((t, x),) = lines(figure, "spool position")
    assert np.max(x) == pytest.approx(1e3 * np.max(warm.values["spool_position"]), rel=1e-12)
    assert (t[0], t[-1]) == (0.0, 0.4)
    assert len(lines(figure, "temperature")) == 8 and len(lines(figure, "nozzle pressures")) == 2
    assert figure.get_suptitle() == "T"


def test_the_picture_of_the_characteristic_has_the_rest_at_20_degrees_dashed(warm):
    figure = report.draw_characteristic(warm, rest_characteristic(warm.scenario))
    dashed = [(x, y) for (x, y) in lines(figure, "spool position") if len(x) == 41]
    ((current, spool),) = dashed
    rest = vs.static_solution(vs.Valve(), current=np.asarray(current) * 1e-3).spool_position
    assert spool == pytest.approx(1e3 * rest, rel=1e-9)
    assert (current[0], current[-1]) == pytest.approx((-1.0, 1.0))


def test_the_rest_in_the_characteristic_is_at_the_commanded_pressure():
    result = run(supply_pressure=vs.Constant(value=7e6))
    figure = report.draw_characteristic(result, rest_characteristic(result.scenario))
    ((current, spool),) = [(x, y) for (x, y) in lines(figure, "spool position") if len(x) == 41]
    rest = vs.static_solution(vs.Valve(supply_pressure=7e6), current=np.asarray(current) * 1e-3).spool_position
    assert spool == pytest.approx(1e3 * rest, rel=1e-9)


def test_the_picture_of_drift_shows_all_routes_and_the_total_in_percent(warm):
    drift, observed = static_drift(warm), observed_drift(warm, vs.simulate(nominal(warm.scenario)))
    total, angle, spool = report.draw_drift(drift, observed, "T").axes
    assert total.get_ylabel() == "drift from 20 °C [%]"
    for axes, quantity in ((angle, "armature_angle"), (spool, "spool_position")):
        shown = {line.get_label(): line.get_ydata() for line in axes.lines}
        assert set(vs.ROUTES) < set(shown)
        assert shown["all together"] == pytest.approx(100 * drift.total[quantity], rel=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"command": vs.Constant(value=0.0)},
        {"command": vs.Constant(value=0.6), "drive": vs.VoltageDrive()},
        {"output_rate": 1.0},  # one sample
        {"title": r"5 $ and \frac{1$ [mA]"},
        {"oil_temperature": vs.Step(before=-40.0, after=100.0, time=0.1)},
    ],
    ids=["no command", "voltage", "one sample", "title of signs", "jump of the oil"],
)
def test_unusual_runs_are_drawn_too(changes, tmp_path):
    for path in pictures(run(**changes), tmp_path):
        assert size(path)[0] >= 1000


def test_a_picture_that_cannot_be_written_is_refused_and_leaves_nothing(warm, tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match="cannot be written"):
        report.picture_run(warm, DAY, tmp_path / "file" / "run.png")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


LONG = st.integers(MOST_POINTS + 1, 40 * MOST_POINTS)


@given(LONG, st.integers(0, 10**9))
def test_thinning_keeps_range_and_span_of_a_line(n, seed):
    t, y = np.arange(n) * 1e-3, np.random.default_rng(seed).normal(size=n)
    thin_t, thin_y = thin(t, y)
    assert len(thin_t) <= MOST_POINTS + 1 and np.all(np.diff(thin_t) >= 0.0)
    assert (thin_t[0], thin_t[-1], thin_y[-1]) == (t[0], t[-1], y[-1])
    assert (thin_y.min(), thin_y.max()) == (y.min(), y.max())


@given(LONG, st.integers(0, 10**9), st.sampled_from([1.0, -1.0]))
def test_thinning_shows_a_spike_of_one_sample_where_it_stands(n, place, spike):
    y = np.zeros(n)
    y[place % n] = spike
    thin_t, thin_y = thin(np.arange(n), y)
    shown = thin_t[np.flatnonzero(thin_y == spike)]
    assert len(shown) > 0 and np.max(np.abs(shown - place % n)) <= n / (MOST_POINTS / 2)


def test_a_short_line_is_not_thinned():
    t, y = np.arange(MOST_POINTS), np.sin(np.arange(MOST_POINTS))
    assert all(np.array_equal(thin, whole) for thin, whole in zip(thin(t, y), (t, y), strict=True))


def test_the_end_of_a_run_shows_about_three_cycles_of_its_command(warm):
    assert 2.5 / 20.0 < report.cycles(warm) < 4.0 / 20.0
    assert report.cycles(run(command=vs.Constant(value=1e-3))) is None


def test_the_texts_of_every_picture_are_plain_and_inside_it(warm):
    drift, observed = static_drift(warm), observed_drift(warm, vs.simulate(nominal(warm.scenario)))
    check_texts(report.draw_run(warm))
    check_texts(report.draw_characteristic(warm, rest_characteristic(warm.scenario)))
    check_texts(report.draw_drift(drift, observed, "T"))


def test_page_and_pictures_carry_title_version_valve_and_date(warm, tmp_path):
    from PIL import Image

    title = "A <b> & " + "long " * 30
    scenario = replace(warm.scenario, title=title, valve=replace(vs.Valve(), null_gap=3e-5))
    result = replace(warm, scenario=scenario)
    picture = report.picture_run(result, DAY, tmp_path / "run.png")
    written = report.page_run(result, [picture], DAY, tmp_path / "run.html", static_drift(warm))
    text = written.read_text(encoding="utf-8")
    origin = f"reference valve with null gap 0.03 mm · valvesim {package_version()} · 2026-01-02"
    assert origin in text and "A &lt;b&gt; &amp; long" in text and "<b>" not in text
    assert "<td>spool position</td>" in text and text.count('<figure class="chart">') == 6 + 3
    assert "data:image" not in text and 'src="http' not in text and 'href="http' not in text  # charts in its place
    with Image.open(picture) as image:
        assert image.text["Title"] == title and image.text["Description"] == origin


def test_the_same_run_on_the_same_day_gives_the_same_bytes(warm, tmp_path):
    first, second, later = (
        report.picture_run(warm, day, tmp_path / f"{k}.png").read_bytes()
        for k, day in enumerate((DAY, DAY, DAY + datetime.timedelta(days=1)))
    )
    assert first == second != later


def test_a_valve_is_named_by_what_differs_from_the_reference():
    assert valve_name(vs.Valve()) == "reference valve"
    assert valve_name(replace(vs.Valve(), supply_pressure=7e6)) == "reference valve with supply pressure 70 bar"
    many = replace(vs.Valve(), supply_pressure=7e6, null_gap=3e-5, nozzle_diameter=4e-4, spool_area=2e-5)
    assert valve_name(many) == "reference valve with 4 parameters changed"


@given(st.floats(-9.0, 9.0), st.floats(0.05, 12.0), st.booleans())
@settings(max_examples=40, deadline=None)
def test_a_logarithmic_axis_of_any_range_has_plain_labels(low, decades, upright):
    figure = Figure(figsize=(5, 5))
    axes = figure.subplots()
    axis = axes.yaxis if upright else axes.xaxis
    (axes.set_yscale if upright else axes.set_xscale)("log")
    (axes.set_ylim if upright else axes.set_xlim)(10.0**low, 10.0 ** (low + decades))
    label_decades(axis)
    FigureCanvasAgg(figure).draw()
    figure.subplots_adjust(left=0.2)
    labels = [label.get_text() for label in tick_labels(axis)]
    assert len(labels) >= (2 if decades >= 1.0 else 0) and not any("$" in text for text in labels)
    for label in tick_labels(axis):
        assert number(label.get_text()) == pytest.approx(label.get_position()[1 if upright else 0], rel=1e-5)


def number(text):
    """The number that a label such as 0.2, 10⁻⁶ or 5·10⁷ stands for."""
    if not set(text) & set("⁻⁰¹²³⁴⁵⁶⁷⁸⁹"):
        return float(text)
    digit, _, power = text.rpartition("10")
    return float(digit.strip("·") or 1) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))


def unpacked(text, n):
    """The numbers of a packed column, as the page's script has them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8)
    return np.ascontiguousarray(planes.reshape(4, n).T).view("<f4").ravel()


@given(st.integers(1, 3000), st.integers(0, 10**9), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_chart_holds_its_numbers_to_single_precision(n, seed, even):
    rng = np.random.default_rng(seed)
    x = np.linspace(1.0, 2.0, n) if even else np.cumsum(rng.uniform(0.1, 1.0, n))
    y = rng.normal(size=n) * 10.0 ** rng.integers(-9, 9)
    y[rng.integers(n)] = np.nan
    spec = Chart("c", x, [Series("y", "mm", y)]).spec
    assert unpacked(spec["series"][0]["data"], n) == pytest.approx(y, rel=1e-6, nan_ok=True)
    axis = spec["x"]
    shown = unpacked(axis["data"], n) if "data" in axis else axis["start"] + axis["step"] * np.arange(n)
    assert shown == pytest.approx(x, rel=1e-6) and spec["n"] == n
    assert json.loads(json.dumps(spec)) == spec


@given(st.integers(2, 9), st.integers(0, 10**9))
@settings(max_examples=10, deadline=None)
def test_a_chart_of_very_many_points_keeps_every_spike_in_its_place(times, seed):
    rng = np.random.default_rng(seed)
    n = MOST_CHART_POINTS * times // 2 + int(rng.integers(1, 1000))
    y = np.zeros(n)
    spikes = rng.choice(n, 5, replace=False)
    y[spikes] = [1.0, -1.0, 2.0, -2.0, 3.0]
    x, (kept,) = thinned(np.arange(n, dtype=float), [y])
    assert len(x) == len(kept) <= MOST_CHART_POINTS + 1 and np.all(np.diff(x) > 0.0)
    stretch = np.ceil(2 * n / MOST_CHART_POINTS)
    for spike in spikes:
        near = np.abs(x - spike) <= stretch
        assert y[spike] in kept[near] or np.count_nonzero(np.abs(spikes - spike) < 2 * stretch) > 1


def test_what_a_chart_shows_is_told_in_words_and_to_its_uncertainty():
    chart = Chart("Flow", np.array([0.0, 2.0]), [Series("load", "L/min", np.array([1.23456, np.nan]), 0.01)])
    assert chart.in_words == "Flow, over time 0 to 2 s: load 1.23 to 1.23 L/min"
    assert chart.spec["series"][0]["digits"] == 2
    assert figure_text(6.3e-15, 1e-5) == "0.00000" and figure_text(-0.0389612, 4e-6) == "-0.038961"
    assert figure_text(270.0, 0.0) == "270"


def test_the_library_that_draws_stands_in_a_page_with_its_licence_and_only_where_there_are_charts(tmp_path):
    block = TitleBlock(title="T", valve="v", date=DAY)
    chart = Chart("</script><b>", np.array([0.0, 1.0]), [Series("<i>", "", np.zeros(2))])
    for charts, there in (([chart], True), ([], False)):
        text = page(block, (section("H", Charts(charts)),))
        assert ("Permission is hereby granted" in text) is there is ("uPlot=function" in text.replace(" ", ""))
        assert "<b>" not in text and "<i>" not in text and text.count("</script>") == (2 if there else 0)


@given(
    st.lists(st.floats(), min_size=1, max_size=40), st.floats(-1e6, 1e6), st.floats(1e-9, 1e6), st.floats(0.0),
    st.booleans(),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_a_chart_of_any_numbers_is_told_and_written(values, start, step, uncertainty, log_x):
    x = np.geomspace(1e-3, 1e3, len(values)) if log_x else start + step * np.arange(len(values))
    chart = Chart("any", x, [Series("y", "", np.array(values), uncertainty)], log_x=log_x)
    spec = json.loads(json.dumps(chart.spec, allow_nan=False))
    told = np.array(values)
    told = np.where(np.abs(told) < 1e38, told, np.nan)
    kept = unpacked(spec["series"][0]["data"], spec["n"])
    assert kept == pytest.approx(told, rel=1e-6, abs=1e-38, nan_ok=True)
    assert 0 <= spec["series"][0]["digits"] <= 9 and chart.in_words.startswith("any, over time ")


@pytest.mark.parametrize("drift", [0.0, 1.0, 100.0])
def test_what_swings_is_seen_on_a_drift_too_and_what_drifts_alone_does_not_swing(drift):
    t = np.linspace(0.0, 10.0, 10_001)
    assert np.count_nonzero(swings(np.sin(2.0 * np.pi * 10.0 * t) + drift * t)) in range(195, 206)
    assert np.count_nonzero(swings(1e7 + drift * t)) <= 1
