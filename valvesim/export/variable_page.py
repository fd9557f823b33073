"""The page that comes with an FMU: what it is, and every variable with unit, range and meaning."""

from __future__ import annotations

from collections.abc import Sequence

from valvesim.export.fmi_variables import FmiVariable
from valvesim.export.model_description import ModelHead

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{{ head.name }}</title><style>
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; } td, th { border: 1px solid #999; padding: .15em .6em; text-align: left; }
td.n { text-align: right; white-space: nowrap; }
</style></head><body>
<h1>{{ head.name }}</h1>
<p>{{ head.description }}. Written by {{ head.generated_by }}; model {{ head.token }}.</p>
<p>SI units, temperatures in °C. The valve starts at rest under the inputs that are set before the run; parts whose
temperature has no start value begin with the oil. Parameters are tunable: they may change during a run. Values beyond
their range, and values that are no numbers, are refused with a message and change nothing.
In co-simulation the valve has its own solver (Rodas5P, variable step); inputs hold within a communication step unless
their derivatives are given (FMI 2.0) or they are set in intermediate updates (FMI 3.0).</p>
{% for heading, rows in tables %}<h2>{{ heading }}</h2>
<table><tr><th>name</th><th>unit</th><th>start</th><th>least</th><th>most</th><th>meaning</th></tr>
{% for row in rows %}<tr>{% for word in row[:2] %}<td>{{ word }}</td>{% endfor %}
{% for figure in row[2:5] %}<td class="n">{{ figure }}</td>{% endfor %}<td>{{ row[5] }}</td></tr>
{% endfor %}</table>
{% endfor %}</body></html>
"""


def variable_page(head: ModelHead, variables: Sequence[FmiVariable]) -> str:
    """The page as HTML."""
    import jinja2

    def rows(causality: str) -> list[tuple[str, ...]]:
        return [
            (one.name, one.unit, _figure(one.start), _figure(one.low), _figure(one.high), one.doc)
            for one in variables
            if one.causality == causality
        ]

    tables = [("Inputs", rows("input")), ("Outputs", rows("output")), ("Parameters", rows("parameter"))]
    return jinja2.Environment(autoescape=True).from_string(_PAGE).render(head=head, tables=tables)


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
