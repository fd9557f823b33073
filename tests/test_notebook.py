"""What a user of the library touches: units everywhere, short names, what objects show of themselves, plots."""

import re

import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st
from picture_texts import check_texts

import valvesim as vs
from valvesim.errors import InputError
from valvesim.notebook import html

ureg = pint.UnitRegistry()
ISOTHERMAL = vs.Thermal(network=None)


@pytest.fixture(scope="module")
def swept():
    chirp = vs.Chirp(amplitude="1 mA", start_frequency="5 Hz", end_frequency="300 Hz", duration="1 s")
    case = vs.Scenario(title="<Sweep>", duration="1.2 s", command=chirp, thermal=ISOTHERMAL, output_rate="4 kHz")
    return vs.simulate(case)


@given(st.floats(0.01, 0.9))
def test_a_quantity_is_what_its_text_and_its_number_are(millimetres):
    number, text, quantity = (
        vs.Valve(null_gap=given) for given in (millimetres * 1e-3, f"{millimetres!r} mm", millimetres * ureg.mm)
    )
    assert text.null_gap == quantity.null_gap == pytest.approx(number.null_gap, rel=1e-12)
    assert isinstance(quantity.null_gap, float)


@pytest.mark.parametrize(
    "make",
    [
        lambda u: vs.Valve(null_gap=3 * u.bar),
        lambda u: vs.Valve(null_gap="0,03 mm"),
        lambda u: vs.Valve(null_gap="0.03"),
        lambda u: vs.Step(after=5 * u.liter / u.minute),
        lambda u: vs.Step(before="5 bar", after="5 mA"),
        lambda u: vs.Scenario(command=vs.Step(after="5 bar")),
        lambda u: vs.Scenario(command=vs.Sum((vs.Step(after=1e-3), vs.Sine(amplitude="1 V")))),
        lambda u: vs.Scenario(command="1 V"),
        lambda u: vs.Scenario(command="1 mA, 2 mA"),
        lambda u: vs.Scenario(command=[1e-3]),
        lambda u: vs.Scenario(command=True),
        lambda u: vs.Scenario(command=None),
        lambda u: vs.Scenario(oil_temperature=None),
        lambda u: vs.simulate(vs.Valve()),
        lambda u: vs.simulate(3),
        lambda u: vs.bench("my valve"),
        lambda u: vs.responses("step"),
        lambda u: vs.step_response(None, amplitude=1e-3),
        lambda u: vs.linearise(vs.Valve()),
        lambda u: vs.Scenario(oil_temperature="20 C"),
        lambda u: vs.Scenario(supply_pressure="200 psig"),
        lambda u: vs.Scenario(duration=1 * u.m),
        lambda u: vs.Thermal(initial_temperature={"body": 3 * u.bar}),
        lambda u: vs.Table(times=(0.0, 1.0) * u.m, values=(0.0, 1.0)),
        lambda u: vs.effect("spool_coulomb_friction")(friction_force=2 * u.mm),
        lambda u: vs.static_solution(vs.Valve(), current=1 * u.V),
        lambda u: vs.static_solution(vs.Valve(), current="1,05 mA"),
        lambda u: vs.operating_point(vs.Valve(), current=0.0, temperature=1 * u.mA),
        lambda u: vs.step_response(vs.Valve(), amplitude="1 V"),
        lambda u: vs.frequency_response(vs.Valve(), amplitude=1e-3, frequencies=(1, 2) * u.s),
        lambda u: vs.bench(oil_temperature="20 bar"),
        lambda u: vs.responses(vs.Valve(), oil_temperatures="20 bar"),
        lambda u: vs.datasheet(oil_temperatures=["20 bar"]),
    ],
)
def test_a_wrong_dimension_is_refused_by_name(make):
    with pytest.raises(InputError) as refused:
        make(ureg)
    assert str(refused.value)[0] not in "'<" and len(str(refused.value)) < 250


def test_what_has_a_unit_is_taken_everywhere():
    ramp = vs.Ramp(start_value="20 degC", end_value=300 * ureg.kelvin, rate="3 degC/s")
    table = vs.Table(times=[0 * ureg.ms, 10 * ureg.ms], values="0, 2 mA")
    case = vs.Scenario(
        duration=20 * ureg.ms, command=table, oil_temperature=ramp, supply_pressure="20 MPa", thermal=ISOTHERMAL,
        output_rate="1 kHz",
    )  # fmt: skip
    assert (case.duration, case.supply_pressure.value) == (0.02, 20e6)
    assert ramp.end_value == pytest.approx(26.85) and ramp.rate == pytest.approx(3.0)
    assert table.times == pytest.approx((0.0, 0.01)) and table.values == pytest.approx((0.0, 2e-3))
    rest = vs.static_solution(vs.Valve(), current=[1, 2] * ureg.mA, temperature="20 degC")
    assert rest.spool_position == pytest.approx(vs.static_solution(vs.Valve(), current=[1e-3, 2e-3]).spool_position)
    assert vs.effect("spool_coulomb_friction")(friction_force=2 * ureg.N).values.friction_force == 2.0
    assert vs.Sine(amplitude="80 K").amplitude == 80.0


def test_a_number_is_a_constant_command_and_a_file_is_simulated_by_name(tmp_path):
    case = vs.Scenario(command=5e-3, duration=0.01, thermal=ISOTHERMAL)
    assert case.command == vs.Constant(value=5e-3)
    path = tmp_path / "own.toml"
    text = case.to_toml(path)
    assert path.read_text(encoding="utf-8") == text == vs.scenario_to_toml(case)
    assert vs.load_scenario(path) == case
    again, whole = vs.simulate(path), vs.simulate(case)
    assert (again["spool_position"].values == whole["spool_position"].values).all()


def test_what_is_looked_at_is_one_line_or_a_page_of_plain_words(swept):
    valve = vs.Valve(null_gap="0.03 mm")
    assert repr(valve) == "<Valve: reference valve with null gap 0.03 mm>"
    for thing in (valve, swept, swept.scenario, vs.effect("spool_coulomb_friction")(friction_force=1.0)):
        assert len(repr(thing)) < 300 and "\n" not in repr(thing)
        page = thing._repr_html_()
        assert page == html(thing) and page.count("<div") == page.count("</div>") and "<html" not in page
    assert "&lt;Sweep&gt;" in swept._repr_html_() and "<Sweep>" not in swept._repr_html_()
    assert "spool position" in swept._repr_html_() and "<td>null_gap</td><td class=\"number\">0.03</td>" in html(valve)


def test_what_hardly_moves_is_told_to_five_digits_and_not_to_its_rounding():
    still = vs.simulate(vs.Scenario(command=5e-3, duration=0.02, thermal=ISOTHERMAL, output_rate=1e4))
    assert not re.search(r"\d\.\d{8}", html(still)) and ">0.19" in html(still)


def test_a_result_plots_itself_and_its_sweep(swept):
    for figure in (swept.plot(), swept.plot("spool_position", "load_flow"), swept.bode()):
        check_texts(figure)
        assert figure._repr_png_().startswith(b"\x89PNG")
    ratio, *_ = swept.bode().axes
    line = ratio.lines[0]
    at_150 = abs(line.get_xdata() - 150.0).argmin()
    assert -4.0 < line.get_ydata()[at_150] < -1.0  # as the stepped sines have it, -3 dB at some 180 Hz
    with pytest.raises(InputError, match="spool_positon.*did you mean"):
        swept.plot("spool_positon")
    with pytest.raises(InputError, match="spool_positon.*did you mean"):
        swept.bode("spool_positon")


def test_a_run_without_a_sweep_has_no_bode():
    with pytest.raises(InputError, match="does not move"):
        vs.simulate(vs.Scenario(command=1e-3, duration=0.05, thermal=ISOTHERMAL, output_rate=1e4)).bode()


def test_a_result_is_a_table_of_pandas(swept):
    table = swept.to_pandas()
    assert list(table.columns) == list(swept.names) and table.index.name == "time"
    assert (table["spool_position"].values == swept.values["spool_position"]).all()


def test_the_top_of_the_package_tells_its_story_and_hides_no_module():
    import pkgutil

    assert set(dir(vs)) == {*vs.__all__, "__version__"} and not any(name.startswith("_") for name in vs.__all__)
    modules = {module.name for module in pkgutil.iter_modules(vs.__path__)}
    assert not modules & set(vs.__all__)
    assert vs.__version__.count(".") >= 1
