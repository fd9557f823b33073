"""Size of three plotting libraries for pages, and the time of a first drawing and of a zoom on 1e6 points in Chromium.

    python benchmarks/plotting_libraries.py FOLDER

FOLDER holds the unpacked npm packages uplot, plotly.js-basic-dist-min, @bokeh/bokehjs (`npm pack NAME`, then tar), each
in a folder `uplot`, `plotly`, `bokeh`. Needs the extra `browser` and the system's Chromium. Times are the median of
five, until the next frame is painted, relative to uPlot too; they depend on the machine and on what else it does.
"""

import statistics
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
DATA = """
const n = 1e6, x = new Float64Array(n), y = new Float64Array(n);
for (let k = 0; k < n; k++) { x[k] = k / n; y[k] = Math.sin(200 * x[k]) + 0.1 * Math.sin(1e5 * x[k]); }
const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
"""
LIBRARIES = {
    "uPlot": (
        ["uplot/dist/uPlot.iife.min.js"],
        "window.p = new uPlot({width: 1000, height: 300, scales: {x: {time: false}}, series: [{}, {stroke: 'blue'}]},"
        " [x, y], document.body)",
        "window.p.setScale('x', {min: 0.3, max: 0.6})",
    ),
    "Plotly (basic)": (
        ["plotly/plotly-basic.min.js"],
        "await Plotly.newPlot(document.body, [{x, y, mode: 'lines'}], {width: 1000, height: 300})",
        "await Plotly.relayout(document.body, {'xaxis.range': [0.3, 0.6]})",
    ),
    "Bokeh": (
        ["bokeh/build/js/bokeh.min.js", "bokeh/build/js/bokeh-api.min.js"],
        "window.f = Bokeh.Plotting.figure({width: 1000, height: 300, x_range: [0, 1]}); window.f.line(x, y);"
        " await Bokeh.Plotting.show(window.f, document.body)",
        "window.f.x_range.start = 0.3; window.f.x_range.end = 0.6",
    ),
}


def measure(browser, folder, scripts, draw, zoom):
    """(first drawing, zoom) in ms, median of five fresh pages."""
    first, second = [], []
    for _ in range(5):
        page = browser.new_page()
        page.set_content("<!DOCTYPE html><body></body>")
        for script in scripts:
            page.add_script_tag(path=folder / script)
        times = page.evaluate(
            f"async () => {{ {DATA} let t = performance.now(); {draw}; await painted();"
            f" const a = performance.now() - t; t = performance.now();"
            f" {zoom}; await painted(); await painted(); return [a, performance.now() - t]; }}"
        )
        first.append(times[0])
        second.append(times[1])
        page.close()
    return statistics.median(first), statistics.median(second)


def main():
    folder = Path(sys.argv[1])
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        rows = {name: measure(browser, folder, *parts) for name, parts in LIBRARIES.items()}
        browser.close()
    base = rows["uPlot"]
    print("| library | script, kB | first drawing, ms | zoom, ms | against uPlot |\n|---|---|---|---|---|")
    for name, (first, zoom) in rows.items():
        size = sum((folder / script).stat().st_size for script in LIBRARIES[name][0]) / 1e3
        print(f"| {name} | {size:.0f} | {first:.0f} | {zoom:.0f} | {first / base[0]:.1f}, {zoom / base[1]:.1f} |")


if __name__ == "__main__":
    main()
