"""An acceptance specification: read strictly, and its verdicts by value and uncertainty."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import valvesim as vs
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit
from valvesim.characterisation.specification import FIGURES, Limit, Verdict, judge, load_specification, verdict
from valvesim.errors import InputError

TEXT = """
title = "38 L/min"
[conditions]
supply_pressure = "210 bar"
oil_temperature = "40 degC"
[figures]
rated_current = "40 mA"
rated_flow = { value = "38 L/min", tolerance = "10 %", pressure_drop = "70 bar", source = "p. 7" }
hysteresis = { high = "3 %" }
null_shift_temperature = { high = "2 %", temperature_difference = "55 K" }
frequency_minus_90_deg = [{ low = "110 Hz" }, { low = "80 Hz", amplitude = "100 %" }]
"""


@pytest.fixture
def read(tmp_path):
    def load(text):
        (tmp_path / "spec.toml").write_text(text, encoding="utf-8")
        return load_specification(tmp_path / "spec.toml")

    return load


def test_limits_have_values_conditions_and_sources_in_si(read):
    spec = read(TEXT)
    (flow,) = spec.of("rated_flow")
    assert (flow.low, flow.value, flow.high) == pytest.approx((34.2 / 6e4, 38.0 / 6e4, 41.8 / 6e4))
    assert flow.conditions == pytest.approx({"supply_pressure": 21e6, "oil_temperature": 40.0, "pressure_drop": 7e6})
    assert flow.source == "p. 7" and flow.deviation == pytest.approx(1.9 / 6e4)
    assert [limit.conditions["amplitude"] for limit in spec.of("frequency_minus_90_deg")] == [0.4, 1.0]
    (shift,) = spec.of("null_shift_temperature")
    assert shift.conditions["temperature_difference"] == pytest.approx(55.0)
    assert vs.load_specification is load_specification


@pytest.mark.parametrize(
    "text, message",
    [
        ("title = 'x'\n", "figures is missing or empty"),
        ("[figures]\nrated_flo = '38 L/min'\n", "line 2: figures: unknown figure of a nozzle-flapper servo valve"),
        ("[figures]\ncracking_pressure = '38 bar'\n", "unknown figure of a nozzle-flapper servo valve"),
        ("[figures]\nrated_flow = '38 bar'\n", "line 2: figures.rated_flow.value: 'bar' has the wrong dimension"),
        ("[figures]\nhysteresis = { low = '3 %', high = '2 %' }\n", "line 2: figures.hysteresis.low: '3 %' is above"),
        ("[figures]\nrated_flow = { value = '9 L/min', high = '5 L/min' }\n", "is outside its own limits"),
        ("[figures]\nrated_flow = { value = '-9 L/min' }\n", "'-9 L/min' must be positive"),
        ("[figures]\nrated_flow = { value = '9 L/min', tolerance = '0 %' }\n", "tolerance: '0 %' must be positive"),
        ("[figures]\nrated_flow = { low = '9 L/min', tolerance = '5 %' }\n", "goes with a value alone"),
        ("[figures]\nrated_flow = { source = 'x' }\n", "needs a value, or a limit low or high"),
        ("[figures]\nrated_flow = { value = '9 L/min', amplitude = '5 %' }\n", "unknown key 'amplitude'"),
        ("[figures]\nphase_lag = { high = '90 deg' }\n", "figures.phase_lag needs frequency"),
        ("[figures]\nrated_flow = { value = '9 L/min', pressure_drop = '1 Pa' }\n", "'1 Pa' is outside"),
        ("[conditions]\nload_pressure = '1 bar'\n", "conditions: unknown key 'load_pressure'"),
        ("[figures]\nrated_flow = [3, '5 L/min']\n", "figures.rated_flow.1.value: 3 has no unit"),
        ("[figures]\nrated_flow = true\n", "expected a quantity such as"),
        ("[figures]\nhysteresis = '< 3 %'\n",
         "line 2: figures.hysteresis.value: '< 3 %' is a limit: write { high = '3 %' }"),
        ("[figures]\nrated_flow = '>= 9 L/min'\n", "write { low = '9 L/min' }"),
        ("[figures]\nrated_flow = { value = '9 L/min', pressure_drop = '35 bar per land' }\n",
         "line 2: figures.rated_flow.pressure_drop: '35 bar per land' is of one land: write twice that"),
        ("[figures]\nrated_current = ['20 mA', '40 mA']\n", "line 2: figures.rated_current is given more than once"),
        ("[figures]\nrated_flow = '5 gpm'\n", "did you mean 'gal/min'?"),
    ],
)  # fmt: skip
def test_a_bad_specification_is_refused_with_its_place(read, text, message):
    with pytest.raises(InputError) as refused:
        read(text)
    assert message in str(refused.value) and "spec.toml" in str(refused.value)


@given(value=st.floats(-10, 10), deviation=st.floats(0, 3), low=st.floats(-5, 5), width=st.floats(0, 5))
def test_a_verdict_passes_or_fails_only_beyond_two_deviations(value, deviation, low, width):
    told = verdict(value, deviation, low, low + width)
    ends = (value - 2 * deviation, value + 2 * deviation)
    inside = low <= ends[0] and ends[1] <= low + width
    outside = ends[1] < low or ends[0] > low + width
    clear = min(abs(end - limit) for end in ends for limit in (low, low + width)) > 1e-9
    assert not clear or told == (Verdict.PASS if inside else Verdict.FAIL if outside else Verdict.UNDECIDED)
    assert verdict(math.nan, deviation, low, low + width) == Verdict.NOT_MEASURED


def test_a_shift_that_is_limited_above_may_not_be_as_large_the_other_way():
    limit = Limit(figure="null_shift_temperature", high=0.02)
    assert limit.verdict(-0.03) == Verdict.FAIL and limit.verdict(-0.01) == Verdict.PASS
    either = Limit(figure="lap", low=-0.01, high=0.03)
    assert either.verdict(-0.02) == Verdict.FAIL and either.verdict(0.02) == Verdict.PASS


def test_a_limit_is_judged_by_the_figures_of_its_conditions(read):
    spec = read(TEXT)
    measured = [
        (FigureOfMerit("flow-load.rated_flow_positive", 37.0 / 6e4, "m^3/s", "", 0.1 / 6e4), {}),
        (FigureOfMerit("flow-load.rated_flow_negative", 34.3 / 6e4, "m^3/s", "", 0.1 / 6e4), {}),
        (FigureOfMerit("frequency_minus_90_deg", 70.0, "Hz", ""), {"amplitude": 1.0}),
        (FigureOfMerit("frequency_minus_90_deg", 150.0, "Hz", ""), {"amplitude": 0.25}),
        (Absent("flow.hysteresis", "too few points"), {}),
        (FigureOfMerit("null-shift.temperature", 0.0, "1", ""), {"temperature_difference": 38.0}),
    ]
    told = [(judged.limit.figure, judged.verdict.value) for judged in judge(spec, measured)]
    assert told == [
        ("rated_flow", "pass"), ("rated_flow", "undecided"),
        ("hysteresis", "not measured"), ("null_shift_temperature", "not measured"),
        ("frequency_minus_90_deg", "not measured"), ("frequency_minus_90_deg", "fail"),
    ]  # fmt: skip
    reasons = [judged.measured.reason for judged in judge(spec, measured) if judged.verdict == Verdict.NOT_MEASURED]
    assert reasons == ["too few points", "no test at its conditions", "no test at its conditions"]


def test_every_figure_has_a_unit_that_is_known_and_conditions_that_are():
    from valvesim.characterisation.specification import CONDITIONS
    from valvesim.units import parse

    for name, figure in FIGURES.items():
        assert set(figure.conditions) <= set(CONDITIONS), name
        assert figure.unit in ("-", "%") or parse("1" if figure.unit == "1" else f"1 {figure.unit}", figure.unit) == 1.0
