// Draws the charts of a page: zoom, cursor values, channels on and off, by mouse, finger or keyboard; in light and dark.
"use strict";
(() => {
  const charts = [];
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    return (name) => style.getPropertyValue(name).trim();
  };

  // A column: base64 of deflate of float32, its bytes apart (all first bytes, all second ones, ...), for these pack well.
  async function column(text, n) {
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const bytes = new Uint8Array(4 * n);
    for (let k = 0; k < 4; k++) for (let i = 0; i < n; i++) bytes[4 * i + k] = planes[k * n + i];
    const values = new Float32Array(bytes.buffer);
    return values.some(Number.isNaN) ? Array.from(values, (v) => (Number.isNaN(v) ? null : v)) : values;
  }

  async function axisValues(x, n) {
    if (x.data) return column(x.data, n);
    return Float64Array.from({ length: n }, (_, k) => x.start + k * x.step);
  }

  const shown = (value, digits) => (value == null ? "–" : value.toFixed(digits));

  function told(chart) {
    const { spec, plot, keys } = chart;
    const at = plot.cursor.idx;
    const x = at == null ? null : plot.data[0][at];
    chart.where.textContent =
      x == null ? "" : `${spec.x.label} ${shown(x, spec.x.digits)}${spec.x.unit ? " " + spec.x.unit : ""}`;
    spec.series.forEach((one, k) => {
      keys[k].textContent = at == null ? "" : `${shown(plot.data[k + 1][at], one.digits)} ${one.unit}`;
    });
  }

  // The charts that move with this one: those of its group.
  const together = (chart) => charts.filter((one) => one === chart || (chart.spec.group && one.spec.group === chart.spec.group));

  function look(chart, low, high) {
    const [first, last] = chart.range;
    const whole = !(high > low) || (low <= first && high >= last);
    for (const one of together(chart)) {
      one.moving = true;
      one.plot.setScale("x", whole ? { min: one.range[0], max: one.range[1] } : { min: low, max: high });
      one.moving = false;
    }
  }

  function zoom(chart, factor, about) {
    const { min, max } = chart.plot.scales.x;
    const to = chart.spec.x.log ? Math.log : (v) => v;
    const from = chart.spec.x.log ? Math.exp : (v) => v;
    const middle = about == null ? (to(min) + to(max)) / 2 : to(about);
    look(chart, from(middle - (middle - to(min)) * factor), from(middle + (to(max) - middle) * factor));
  }

  function pan(chart, share) {
    const to = chart.spec.x.log ? Math.log : (v) => v;
    const from = chart.spec.x.log ? Math.exp : (v) => v;
    const [first, last] = chart.range.map(to);
    const { min, max } = chart.plot.scales.x;
    const width = to(max) - to(min);
    const low = Math.min(Math.max(to(min) + share * width, first), last - width);
    look(chart, from(low), from(low + width));
  }

  function step(chart, by) {
    const { plot } = chart;
    const { min, max } = plot.scales.x;
    const x = plot.data[0];
    let at = plot.cursor.idx ?? plot.valToIdx((min + max) / 2);
    const inView = plot.valToIdx(max) - plot.valToIdx(min);
    at = Math.min(Math.max(at + by * Math.max(1, Math.round(inView / 200)), 0), x.length - 1);
    plot.setCursor({ left: plot.valToPos(x[at], "x"), top: plot.bbox.height / devicePixelRatio / 2 });
    told(chart);
    const values = chart.spec.series
      .map((one, k) => (plot.series[k + 1].show ? `${one.name} ${chart.keys[k].textContent}` : ""))
      .filter(Boolean);
    chart.spoken.textContent = `${chart.where.textContent}: ${values.join(", ")}`;
  }

  const acts = {
    "+": (chart) => zoom(chart, 0.5, chart.plot.cursor.idx == null ? null : chart.plot.data[0][chart.plot.cursor.idx]),
    "-": (chart) => zoom(chart, 2),
    0: (chart) => look(chart, ...chart.range),
    ArrowLeft: (chart, shift) => (shift ? pan(chart, -0.25) : step(chart, -1)),
    ArrowRight: (chart, shift) => (shift ? pan(chart, 0.25) : step(chart, 1)),
  };

  function options(chart, width) {
    const { spec } = chart;
    const colour = colours();
    const axis = { stroke: colour("--ink"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line") },
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
    const unit = spec.x.unit ? ` [${spec.x.unit}]` : "";
    return {
      width,
      height: chart.height,
      legend: { show: false },
      cursor: { drag: { x: true, y: false }, sync: spec.group ? { key: spec.group } : undefined, focus: { prox: 24 } },
      scales: { x: { time: false, distr: spec.x.log ? 3 : 1, range: (plot, min, max) => [min, max] } },
      axes: [
        { ...axis, label: `${spec.x.label}${unit}`, labelSize: 16, labelGap: 0, size: 28 },
        { ...axis, label: spec.y, labelSize: 18, size: 62 },
      ],
      series: [
        {},
        ...spec.series.map((one, k) => ({
          label: one.name,
          stroke: colour(`--c${(one.colour ?? k) % 8}`),
          width: one.points ? 0 : 1.3,
          dash: one.dashed ? [6, 4] : undefined,
          points: { show: !!one.points, size: 5, fill: colour(`--c${(one.colour ?? k) % 8}`) },
          spanGaps: !!one.joined,
          show: chart.plot ? chart.plot.series[k + 1].show : true,
        })),
      ],
      hooks: {
        setCursor: [(plot) => chart.plot === plot && told(chart)],
        setScale: [(plot, key) => {
          if (key !== "x" || chart.plot !== plot || chart.moving) return;
          const { min, max } = plot.scales.x;
          look(chart, min, max);
        }],
      },
    };
  }

  function draw(chart) {
    const width = Math.max(chart.canvas.clientWidth, 240);
    const view = chart.plot ? { ...chart.plot.scales.x } : null;
    const made = options(chart, width);
    if (chart.plot) chart.plot.destroy();
    chart.plot = new uPlot(made, chart.data, chart.canvas);
    if (view && view.min != null) {
      chart.moving = true;
      chart.plot.setScale("x", { min: view.min, max: view.max });
      chart.moving = false;
    }
    for (const canvas of chart.canvas.querySelectorAll("canvas")) canvas.setAttribute("aria-hidden", "true");
    chart.swatches.forEach((swatch, k) => {
      swatch.style.background = colours()(`--c${(chart.spec.series[k].colour ?? k) % 8}`);
    });
  }

  function button(text, name, act) {
    const one = document.createElement("button");
    one.type = "button";
    one.textContent = text;
    one.setAttribute("aria-label", name);
    one.title = name;
    one.addEventListener("click", act);
    return one;
  }

  async function build(figure) {
    const spec = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
    const canvas = figure.querySelector(".plot");
    const chart = { spec, canvas, height: spec.height, keys: [], swatches: [] };
    chart.data = [await axisValues(spec.x, spec.n)];
    for (const one of spec.series) chart.data.push(await column(one.data, spec.n));
    chart.range = [chart.data[0][0], chart.data[0][spec.n - 1]];
    const keys = figure.querySelector(".keys");
    spec.series.forEach((one, k) => {
      const label = document.createElement("label");
      const box = document.createElement("input");
      box.type = "checkbox";
      box.checked = true;
      box.addEventListener("change", () => chart.plot.setSeries(k + 1, { show: box.checked }));
      const swatch = document.createElement("span");
      swatch.className = "swatch";
      const value = document.createElement("output");
      label.append(box, swatch, document.createTextNode(one.name), value);
      keys.append(label);
      chart.keys.push(value);
      chart.swatches.push(swatch);
    });
    chart.where = figure.querySelector(".where");
    chart.spoken = figure.querySelector(".spoken");
    const tools = figure.querySelector(".tools");
    const title = spec.title;
    tools.append(
      button("+", `Zoom in: ${title}`, () => acts["+"](chart)),
      button("−", `Zoom out: ${title}`, () => acts["-"](chart)),
      button("◂", `Earlier: ${title}`, () => pan(chart, -0.25)),
      button("▸", `Later: ${title}`, () => pan(chart, 0.25)),
      button("Whole", `Show the whole: ${title}`, () => acts[0](chart)),
    );
    charts.push(chart);
    draw(chart);
    canvas.addEventListener("keydown", (event) => {
      const act = acts[event.key === "=" ? "+" : event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act(chart, event.shiftKey);
    });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      const left = event.clientX - chart.plot.over.getBoundingClientRect().left;
      zoom(chart, (event.deltaY || event.deltaX) > 0 ? 1.3 : 1 / 1.3, chart.plot.posToVal(left, "x"));
    }, { passive: false });
    let last = canvas.clientWidth;
    new ResizeObserver(() => {
      if (Math.abs(canvas.clientWidth - last) < 2) return;
      last = canvas.clientWidth;
      chart.plot.setSize({ width: Math.max(last, 240), height: chart.height });
    }).observe(canvas);
  }

  function theme(name) {
    document.documentElement.dataset.theme = name;
    const toggle = document.getElementById("theme");
    if (toggle) toggle.textContent = name === "dark" ? "Light" : "Dark";
    charts.forEach(draw);
  }

  const dark = matchMedia("(prefers-color-scheme: dark)");
  document.documentElement.dataset.theme = dark.matches ? "dark" : "light";
  document.addEventListener("DOMContentLoaded", async () => {
    const toggle = document.getElementById("theme");
    toggle.hidden = false;
    toggle.addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
    theme(document.documentElement.dataset.theme);
    dark.addEventListener("change", (event) => theme(event.matches ? "dark" : "light"));
    let before = null;
    addEventListener("beforeprint", () => { before = document.documentElement.dataset.theme; theme("light"); });
    addEventListener("afterprint", () => theme(before || "light"));
    for (const figure of document.querySelectorAll("figure.chart")) await build(figure);
    document.documentElement.dataset.ready = "yes";
  });
  window.valvesimCharts = charts;
})();
