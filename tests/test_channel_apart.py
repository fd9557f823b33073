"""A channel that does not go with the others is told as that, and a second-order response of it by its figures."""

import re
from dataclasses import dataclass
from types import SimpleNamespace

import hidden_plant
import numpy as np
import pytest
from hidden_plant import draw, shortened, write_session
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow_but
from scipy.signal import bilinear, lfilter

import valvesim as vs
from valvesim.diagnosis import channel_apart as own
from valvesim.diagnosis.advice import advice_on_unknown
from valvesim.diagnosis.channel_apart import ChannelApart, ReadAgainst, channel_apart, second_order_response
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS
from valvesim.diagnosis.result import CHANNEL_APART
from valvesim.errors import SolveError

OPTIONS = DEFAULT_DIAGNOSIS.channel_apart
RATE, FINE = 1000.0, 32


def through(x, denominator, fine=FINE * RATE):
    """A series on a fine clock behind an analogue filter of unit gain, from rest: an oracle by the bilinear rule."""
    b, a = bilinear([1.0], denominator, fine)
    return x[0] + lfilter(b, a, x - x[0])


def read_through(denominator, noise=2e-3, seed=1, late=0.0, gain=1.0):
    """A swing of rising frequency and what a chain makes of it, as 1 kHz samples with noise; two records."""
    draw_ = np.random.default_rng(seed)
    for cycles in (20.0, 80.0):
        fine = np.arange(int(FINE * RATE)) / (FINE * RATE)
        swing = np.sin(2.0 * np.pi * (2.0 + 0.5 * cycles * fine) * fine)
        y = gain * np.interp(fine - late, fine, through(swing, denominator))[::FINE]
        y = y + noise * draw_.normal(size=len(y))
        yield ReadAgainst(fine[::FINE], swing[::FINE], y, np.full(len(y), True), noise)


@pytest.mark.parametrize("seed, samples, channel, frequency, damping", slow_but(
    [(3400026, 401, "load_flow", 60.0, 0.5)],
    [(3400026, 401, "load_flow", 60.0, 0.5), (3400031, 1001, "load_flow", 45.0, 0.7),
     (3400034, 1001, "spool_position", 70.0, 0.9)],
))  # fmt: skip
def test_a_meter_of_second_order_is_told_by_its_figures(
    tmp_path, monkeypatch, seed, samples, channel, frequency, damping
):
    """A healthy valve; the errors told are those of the fit to the other channels, which the meter does not drag along.

    Its figures had been fitted from where the meter had dragged them: of the second nothing was told, in 180 s.
    """
    plain, w = hidden_plant._read, 2.0 * np.pi * frequency

    def read(case, run, meter, t, values, hidden):
        if meter.channel == channel:
            values = through(values, [1.0 / w**2, 2.0 * damping / w, 1.0], 1.0 / (t[1] - t[0]))
        return plain(case, run, meter, t, values, hidden)

    monkeypatch.setattr(hidden_plant, "_read", read)
    write_session(shortened(draw(seed, "none"), samples), tmp_path)
    found = vs.diagnose(tmp_path)
    assert (found.verdict, found.reason) == ("unknown", CHANNEL_APART) and not found.extension_offered
    told = re.search(rf"{channel} .* \((\S+) Hz, damping ratio (\S+)\)", found.summary)
    assert told and float(told[1]) == pytest.approx(frequency, rel=0.01)
    assert float(told[2]) == pytest.approx(damping, rel=0.02)
    others = [error for by in found.errors.values() for name, error in by.items() if name != channel]
    assert np.median(others) < 1.2 and max(by[channel] for by in found.errors.values()) > 10.0


@settings(max_examples=25)
@given(st.floats(20.0, 150.0), st.floats(0.2, 1.2), st.floats(0.9, 1.1), st.integers(0, 99))
def test_a_response_of_second_order_is_found(frequency, damping, gain, seed):
    w = 2.0 * np.pi * frequency
    read = list(read_through([1.0 / w**2, 2.0 * damping / w, 1.0], seed=seed, gain=gain))
    found = second_order_response(read, options=OPTIONS)
    if found is None:  # a well damped chain acts as a lag with a delay
        assert damping > 0.6
    else:
        assert found == (pytest.approx(frequency, rel=0.05), pytest.approx(damping, rel=0.05))


@pytest.mark.parametrize("lag, late", [(0.0, 0.0), (5e-4, 0.0), (5e-3, 0.0), (2e-3, 1.5e-3), (0.0, 2e-3)])
def test_a_lag_and_a_delay_are_none(lag, late):
    denominator = [lag, 1.0] if lag else [1.0]
    assert second_order_response(list(read_through(denominator, late=late)), options=OPTIONS) is None


def test_what_is_no_response_is_none():
    """Play of one fiftieth of the swing, and a curve."""
    for bend in (lambda y: y + 0.02 * np.sign(np.gradient(y)), lambda y: y - 0.05 * y**3):
        read = [ReadAgainst(o.time, o.x, bend(o.y), o.usable, o.deviation) for o in read_through([1.0])]
        assert second_order_response(read, options=OPTIONS) is None


@pytest.mark.parametrize("x, deviation, usable", [(0.0, 1.0, True), (1.0, 1e6, True), (1.0, 1e-3, False)])
def test_readings_within_their_noise_and_none_that_are_usable_tell_no_response(x, deviation, usable):
    """Random channels had been told as responses where nothing was left to explain."""
    draw_, time = np.random.default_rng(4), np.arange(300) / RATE
    y = draw_.normal(size=300) * min(deviation, 1.0)
    read = [ReadAgainst(time, x * np.cumsum(draw_.normal(size=300)), y, np.full(300, usable), deviation)]
    assert second_order_response(read, options=OPTIONS) is None


@pytest.mark.parametrize("shows, without, told", [
    (40.0, {"b"}, "b"), (40.0, {"a", "b"}, None), (40.0, set(), None), (7.0, {"b"}, None),
])  # fmt: skip
def test_one_channel_is_apart_where_without_it_alone_nothing_is_wrong(monkeypatch, shows, without, told):
    """Of two that both hide it, neither; nor of what shows so little that leaving out any may hide it."""
    record = SimpleNamespace(outputs=("a", "b", "c"))
    nominal = SimpleNamespace(study=SimpleNamespace(session=SimpleNamespace(training=[record])))
    scores = SimpleNamespace(z=lambda: np.array([shows]), level=lambda false_alarm: 4.0)
    monkeypatch.setattr(own, "_may_be_apart", lambda n, names, options: names)
    monkeypatch.setattr(own, "_without_channel", lambda n, name, options: nominal if name in without else None)
    monkeypatch.setattr(own, "_with_channel", lambda n, name, whole: n)
    monkeypatch.setattr(own, "_response", lambda *_, **__: "")
    found = channel_apart(nominal, scores, options=DEFAULT_DIAGNOSIS)
    assert (found and found.name) == told
    record.outputs = ("b",)
    assert channel_apart(nominal, scores, options=DEFAULT_DIAGNOSIS) is None


def test_a_channel_may_be_apart_where_the_others_come_near_the_stated_valve(monkeypatch):
    """One parameter is what the first channel misses but for noise, the second misses what it has not got."""
    draws, p = np.random.default_rng(3), 1
    residual = np.concatenate([5.0 + draws.normal(size=200), 20.0 * np.arange(200) + draws.normal(size=200)])
    fit = SimpleNamespace(residual=residual, point=np.zeros(p))
    J = np.concatenate([np.full((200, 1), 2.0), np.zeros((200, 1))])
    record = SimpleNamespace(outputs=("a", "b"))
    study = SimpleNamespace(predictors=[SimpleNamespace(record=record)], nominal=SimpleNamespace(
        limits=np.array([[-9.0], [9.0]])), expected_squares=lambda record, name: np.ones(200))  # fmt: skip
    nominal = SimpleNamespace(study=study, fit=fit)

    def stuck(study, fit):
        raise SolveError("no valve has these figures")

    monkeypatch.setattr(own, "is_adequate", lambda fit, options: False)
    monkeypatch.setattr(own, "evaluate_fit", lambda study, point, fitted: fit)
    monkeypatch.setattr(own, "with_edges_searched", lambda study, fit: fit)
    monkeypatch.setattr(own, "linearise_nominal", lambda study, fit: SimpleNamespace(J=J, fit=fit))
    assert own._may_be_apart(nominal, ["a", "b", "c"], options=DEFAULT_DIAGNOSIS) == ["b"]
    fit.residual[:] = 2.0 * draws.normal(size=400)  # near the records, and as near without any of them
    assert own._may_be_apart(nominal, ["a", "b"], options=DEFAULT_DIAGNOSIS) == []
    monkeypatch.setattr(own, "linearise_nominal", stuck)
    assert own._may_be_apart(nominal, ["a", "b"], options=DEFAULT_DIAGNOSIS) == ["a", "b"]
    monkeypatch.setattr(own, "is_adequate", lambda fit, options: True)
    assert own._may_be_apart(nominal, ["a", "b"], options=DEFAULT_DIAGNOSIS) == ["a", "b"]


def test_a_channel_that_no_record_or_not_every_record_can_use_is_left_out_of_the_others(monkeypatch):
    """A record whose readings of it are of no use had ended the diagnosis with a KeyError."""
    @dataclass(frozen=True)
    class Logged:
        values: dict
        usable: dict

        @property
        def outputs(self):
            return tuple(self.usable)

    def nominal(*records):
        study = SimpleNamespace(predictors=[SimpleNamespace(record=one) for one in records], unweighted=lambda: None)
        return SimpleNamespace(study=study)

    seen = list[Logged]()

    def with_records(study, records, notes):
        seen.extend(records)
        raise SolveError("as far as this test goes")

    monkeypatch.setattr(own, "with_records", with_records)
    values = {"current": 1.0, "a": 2.0, "b": 3.0}
    records = [Logged(values, {"a": True, "b": True}), Logged(values, {"a": True})]
    with pytest.raises(SolveError):
        own._without_channel(nominal(*records), "b", options=DEFAULT_DIAGNOSIS)
    assert [(one.values, one.usable) for one in seen] == [({"current": 1.0, "a": 2.0}, {"a": True})] * 2
    assert own._without_channel(nominal(records[1]), "a", options=DEFAULT_DIAGNOSIS) is None  # none is left to fit


def test_a_channel_apart_is_told_in_words_with_what_to_do():
    assert ChannelApart("load_flow", "", None).words.endswith("it, or what no other channel shows, is wrong")
    assert ChannelApart("load_flow", "a lag explains it", None).words.endswith("nothing is wrong: a lag explains it")
    (told,) = advice_on_unknown(CHANNEL_APART, "load_flow", None)
    assert told.label == "the channel load_flow" and "another instrument" in told.confirm
