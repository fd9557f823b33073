"""Pictures and page of responses, as the standards draw them: Bode at each amplitude, steps, distortion, bandwidth."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.characterisation.class_figures import ClassFigure, class_figures
from valvesim.characterisation.figure_of_merit import Absent, merit_rows
from valvesim.characterisation.judgement_table import FIGURE_HEADINGS
from valvesim.io import check_folder
from valvesim.reports.chart import Chart, Charts, Series, on_one_axis
from valvesim.reports.html_page import Picture, Section, Table, section, write_html
from valvesim.reports.plotting import COLOURS, Figure, label_decades, png, styled, write_bytes
from valvesim.reports.title_block import TitleBlock
from valvesim.units import DISPLAY, symbol

if TYPE_CHECKING:
    from valvesim.characterisation.frequency_response import FrequencyResponse
    from valvesim.characterisation.response_set import ResponseSet
    from valvesim.characterisation.step_response import StepResponse

RESPONSE_CAPTIONS = {
    "bode": "Frequency response at each amplitude; rings: -3 dB and -90 degrees.",
    "distortion": "Harmonics 2 to 5 of the response over the fundamental.",
    "step": "Step responses, each as a share of its own change.",
    "bandwidth": "Bandwidth and step time over oil temperature; shaded: usual for the class.",
}


def response_report(
    sets: Sequence[ResponseSet], folder: Path, *, valve: str, date: datetime.date
) -> tuple[Path, ...]:  # fmt: skip
    """Draw every response into `folder`, with a page: the paths of the pictures and of response.html.

    Raises InputError for a folder that cannot be written.
    """
    folder = Path(folder)
    check_folder(folder)
    at = ", ".join(f"{one.oil_temperature:g} °C" for one in sets)
    facts = (("Oil at", at), *((("Dither", sets[0].dither.in_words()),) if sets[0].dither.amplitude else ()))
    block = TitleBlock(title="Step and frequency response", valve=valve, date=date, facts=facts)
    pictures = {name: png(figure, block) for name, figure in draw_responses(sets).items()}
    paths = [write_bytes(data, folder / f"{name}.png") for name, data in pictures.items()]
    charts = section("Responses", Charts(response_charts(sets), beside=True))
    shown = section("Pictures", *(Picture(data, RESPONSE_CAPTIONS[name]) for name, data in pictures.items()))
    return *paths, write_html(folder / "response.html", block, (charts, *_tables(sets), shown))


def frequency_charts(responses: Sequence[tuple[str, Sequence[FrequencyResponse]]], group: str = "") -> list[Chart]:
    """Amplitude ratio, phase and distortion of responses over frequency: a (name, responses) each condition."""
    lines: dict[str, list[Series]] = {"amplitude ratio [dB]": [], "phase [°]": [], "distortion [%]": []}
    every = [(name, one) for name, several in responses for one in several]
    x, _ = on_one_axis([(one.frequency, one.frequency) for _, one in every])
    for k, (name, response) in enumerate(every):
        text = " ".join(filter(None, (name, _amplitude(response)))) if np.isfinite(response.share) else name or "run"
        values = (response.amplitude_ratio, -response.phase_lag, 100.0 * response.distortion)
        for series, unit, given in zip(lines.values(), ("dB", "°", "%"), values, strict=True):
            on = np.full(len(x), np.nan)
            on[np.searchsorted(x, response.frequency)] = np.where(response.credible, given, np.nan)
            if np.isfinite(on).any():
                series.append(Series(text, unit, on, 0.01, colour=k, joined=True))
    own = group or "frequency"
    return [
        Chart(label.partition(" [")[0].capitalize(), x, series, "frequency", "Hz", label, True, own, 260)
        for label, series in lines.items()
        if series
    ]


def step_charts(sets: Sequence[ResponseSet]) -> list[Chart]:
    """Each step as a share of its own change, a chart each oil temperature."""
    charts = []
    for one in sets:
        steps = [step for step in one.steps if _value(step, "change")]
        if not steps:
            continue
        x, series = _after_step(steps[0]), []
        for step in steps:
            share = (step.output - step.output[0]) / (_value(step, "change") or 1.0)
            series.append(Series(_amplitude(step), "", np.interp(x, _after_step(step), share), 1e-3))
        title = f"Steps, oil at {one.oil_temperature:.4g} °C"
        charts.append(Chart(title, x, series, "time after the step", "ms", "share of the change", False, "steps", 260))
    return charts


def _after_step(step: StepResponse) -> np.ndarray:
    """Time after the jump of the command, ms."""
    return np.asarray((step.time - step.time[int(np.argmax(step.command != step.command[0]))]) * 1e3)


def response_charts(sets: Sequence[ResponseSet]) -> list[Chart]:
    """Bode, distortion and steps of every set."""
    swept = [(f"{one.oil_temperature:.4g} °C,", one.sweeps) for one in sets if one.sweeps]
    return [*(frequency_charts(swept) if swept else []), *step_charts(sets)]


def _tables(sets: Sequence[ResponseSet]) -> list[Section]:
    """The figures of merit of each test."""
    sections = []
    for one in sets:
        tests: tuple[Any, ...] = (*one.steps, *one.sweeps)
        for test in tests:
            kind = "Step" if test in one.steps else "Sines"
            heading = f"{kind} of {_amplitude(test)} of rated, oil at {one.oil_temperature:g} °C"
            sections.append(section(heading, Table(FIGURE_HEADINGS, merit_rows(test.figures), (1, 2))))
    return sections


def draw_responses(sets: Sequence[ResponseSet]) -> dict[str, Figure]:
    """Pictures by name: bode, distortion, step and, of two or more temperatures, bandwidth; what the sets have."""
    drawn: dict[str, Figure] = {}
    if all(one.sweeps for one in sets):
        drawn |= {"bode": draw_bode(sets), "distortion": draw_distortion(sets)}
    if all(one.steps for one in sets):
        drawn["step"] = draw_steps(sets)
    if len(sets) > 1 and all(one.sweeps and one.steps for one in sets):
        drawn["bandwidth"] = draw_bandwidth(sets)
    return drawn


@styled
def draw_bode(sets: Sequence[ResponseSet]) -> Figure:
    """Amplitude ratio above, phase lag below, a column each oil temperature; -3 dB and -90 degrees marked."""
    figure, axes = _columns(sets, 2, height=7.0)
    for one, column in zip(sets, axes.T, strict=True):
        ratio, lag = column
        for k, sweep in enumerate(one.sweeps):
            colour = COLOURS[k]
            for axis, name, level, values in (
                (ratio, "frequency_minus_3_db", -3.0, sweep.amplitude_ratio),
                (lag, "frequency_minus_90_deg", -90.0, -sweep.phase_lag),
            ):
                at = _value(sweep, name)
                text = _amplitude(sweep) + ("" if at is None else f": {at:.0f} Hz")
                axis.semilogx(sweep.frequency, values, color=colour, lw=_width(k, one.sweeps), label=text)
                if at is not None:
                    axis.plot(at, level, "o", ms=6, mfc="none", mew=1.4, color=colour, zorder=3)
        for k, chirp in enumerate(one.chirps):
            label = "chirps" if k == len(one.chirps) - 1 else None
            keep = chirp.credible
            style: Any = {"color": "k", "lw": 0.7, "ls": ":"}
            ratio.semilogx(chirp.frequency[keep], chirp.amplitude_ratio[keep], label=label, **style)
            lag.semilogx(chirp.frequency[keep], -chirp.phase_lag[keep], **style)
        ratio.axhline(-3.0, color="0.5", lw=0.8, ls="--")
        lag.axhline(-90.0, color="0.5", lw=0.8, ls="--")
        ratio.set_title(f"oil at {one.oil_temperature:.4g} °C", loc="left")
        ratio.legend(loc="lower left", title="sine, share of rated: at -3 dB", alignment="left")
        lag.legend(loc="lower left", title="at -90°", alignment="left")
        lag.set_yticks(np.arange(-360, 1, 45))
        _hertz(lag)
    lowest = min(float(np.min(sweep.amplitude_ratio)) for one in sets for sweep in one.sweeps)
    farthest = max(float(np.max(sweep.phase_lag)) for one in sets for sweep in one.sweeps)
    axes[0, 0].set_ylim(max(lowest - 2.0, -40.0), 3.0)
    axes[1, 0].set_ylim(-min(45.0 * np.ceil(farthest / 45.0 + 0.2), 360.0), 8.0)
    axes[0, 0].set_ylabel("amplitude ratio to lowest frequency [dB]")
    axes[1, 0].set_ylabel("phase [°]")
    channel = sets[0].sweeps[0].channel.replace("_", " ")
    figure.suptitle(f"Frequency response of the {channel}", fontsize=12)
    return figure


@styled
def draw_distortion(sets: Sequence[ResponseSet]) -> Figure:
    """Harmonic distortion over frequency, a column each oil temperature."""
    figure, axes = _columns(sets, 1, height=4.2)
    for one, axis in zip(sets, axes[0], strict=True):
        for k, sweep in enumerate(one.sweeps):
            axis.loglog(
                sweep.frequency, 100.0 * sweep.distortion, ".-", ms=3, color=COLOURS[k], label=_amplitude(sweep)
            )
        axis.set_title(f"oil at {one.oil_temperature:.4g} °C", loc="left")
        axis.legend(loc="best", title="sine, share of rated", alignment="left")
        _hertz(axis)
        label_decades(axis.yaxis)
    axes[0, 0].set_ylabel("harmonics 2 to 5 over fundamental [%]")
    figure.suptitle("Harmonic distortion", fontsize=12)
    return figure


@styled
def draw_steps(sets: Sequence[ResponseSet]) -> Figure:
    """Each step as a share of its own change, a column each oil temperature; 0-90 % time marked."""
    figure, axes = _columns(sets, 1, height=4.6)
    end = 1.6 * max((_value(s, "settling_time") or 0.0 for one in sets for s in one.steps), default=0.0) or None
    for one, axis in zip(sets, axes[0], strict=True):
        for k, step in enumerate(one.steps):
            start = step.time[int(np.argmax(step.command != step.command[0]))]
            change = _value(step, "change")
            if change is None:
                continue
            share = (step.output - step.output[0]) / change
            unit, factor = DISPLAY.get(step.unit, (step.unit, 1.0))
            ninety = _value(step, "time_to_90_percent")
            text = f"{100 * step.share:.3g} %: {change * factor:.3g} {symbol(unit)}"
            if ninety is not None:
                text += f", 90 % in {ninety * 1e3:.3g} ms"
                axis.plot(ninety * 1e3, 0.9, "o", ms=5, color=COLOURS[k], zorder=3)
            axis.plot(
                (step.time - start) * 1e3, share, color=COLOURS[k], lw=_width(k, one.steps), label=text
            )  # fmt: skip
        for level, style in ((0.9, ":"), (0.95, "--"), (1.05, "--")):
            axis.axhline(level, color="0.5", lw=0.8, ls=style)
        axis.set_title(f"oil at {one.oil_temperature:.4g} °C", loc="left")
        axis.set_xlabel("time after the step [ms]")
        axis.legend(loc="lower right", title="step, share of rated", alignment="left")
        if end:
            axis.set_xlim(-0.05 * end * 1e3, end * 1e3)
    axes[0, 0].set_ylabel("share of the change [-]")
    channel = sets[0].steps[0].channel.replace("_", " ")
    figure.suptitle(f"Step response of the {channel}; dashed: ±5 %", fontsize=12)
    return figure


@styled
def draw_bandwidth(sets: Sequence[ResponseSet]) -> Figure:
    """-3 dB and -90 degree frequencies and the 0-90 % time over oil temperature, those of the class shaded."""
    published = {one.name: one for one in class_figures()}
    panels = (
        ("frequency_minus_3_db", "-3 dB frequency [Hz]", 1.0),
        ("frequency_minus_90_deg", "-90° frequency [Hz]", 1.0),
        ("time_to_90_percent", "0-90 % time [ms]", 1e3),
    )
    figure = Figure(figsize=(11, 4.2))
    axes = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.06, right=0.98, top=0.84, bottom=0.13, wspace=0.25)
    temperature = [one.oil_temperature for one in sets]
    for (name, label, factor), axis in zip(panels, axes, strict=True):
        responses = [one.steps if name == "time_to_90_percent" else one.sweeps for one in sets]
        rows = list(zip(*responses, strict=True))
        for k, row in enumerate(rows):
            values = [_value(response, name) for response in row]
            shown = [np.nan if value is None else value * factor for value in values]
            axis.plot(temperature, shown, "o-", ms=4, color=COLOURS[k], lw=_width(k, rows), label=_amplitude(row[0]))
        _shade(axis, published[name], factor)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("oil temperature [°C]")
        axis.set_ylabel(label)
        axis.legend(loc="best", title="share of rated", alignment="left")
    figure.suptitle("Bandwidth and step time over temperature; shaded: usual for the class", fontsize=12)
    return figure


def _columns(sets: Sequence[ResponseSet], rows: int, *, height: float) -> tuple[Figure, Any]:
    """A figure of `rows` by one column a temperature, axes shared."""
    width = max(7.0, 1.0 + 3.6 * len(sets))
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(rows, len(sets), sharex=True, sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.75 / width, right=1.0 - 0.2 / width, top=1.0 - 0.75 / height, bottom=0.55 / height, wspace=0.08,
        hspace=0.1,
    )  # fmt: skip
    return figure, axes


def _hertz(axis: Any) -> None:
    axis.set_xlabel("frequency [Hz]")
    label_decades(axis.xaxis)


def _amplitude(response: StepResponse | FrequencyResponse) -> str:
    return f"{100 * response.share:.3g} %" if np.isfinite(response.share) else "measured"


def _width(k: int, lines: Sequence[Any]) -> float:
    """Of the k-th line: the first is the widest, so that one upon another still shows."""
    return 1.1 + 2.6 * (len(lines) - 1 - k) / max(len(lines) - 1, 1)


def _value(response: StepResponse | FrequencyResponse, name: str) -> float | None:
    """The figure of merit of that name, None where it is absent."""
    merit = next(merit for merit in response.figures if merit.name == name)
    return None if isinstance(merit, Absent) else merit.value


def _shade(axis: Any, published: ClassFigure, factor: float) -> None:
    axis.axhspan(published.low * factor, published.high * factor, color="0.5", alpha=0.12, lw=0)
