"""What a bench may do, in words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import known_faults
from valvesim.diagnosis.known_faults import _clock_words, _shift_words, _waves_apart
from valvesim.identification.input_waves import wave_parameters, wave_words
from valvesim.identification.instrument_errors import contrasts, is_of_meter, meter_gains, meter_zeros
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION
from valvesim.identification.prior import largest_reading
from valvesim.identification.sensor_errors import active_in, reads_channel
from valvesim.identification.session import Record, value_text
from valvesim.inputs import evaluate
from valvesim.valve.effect import check_listed_once

TIME = np.arange(1000) / 1e3
RECORDS = tuple(Record(name, TIME, {"spool_position": 0.0 * TIME, "current": TIME}, {"spool_position": TIME >= 0.0})
                for name in ("a", "b"))  # fmt: skip


def test_a_wave_has_any_amplitude_and_phase_in_each_record_and_is_told_by_its_amplitude():
    wave = wave_parameters(RECORDS, "supply_pressure", 37.0, 1e6)
    assert len({p.name for p in wave}) == 4 and {p.input.record for p in wave} == {"a", "b"}
    assert wave_words(wave, np.array([3e5, 4e5, -4e5, 3e5])) == "the supply pressure ripples by 5 bar at 37 Hz"
    first, second = (evaluate(p.input.command(1.0), np.array([0.1])) for p in wave[:2])
    assert first**2 + second**2 == pytest.approx(1.0)
    said = _shift_words("oil_temperature", growing=True)(np.array([1.0, -3.0]))
    assert said.startswith("the oil temperature is off by up to 3 ") and said.endswith("within a record")


def test_of_waves_too_close_to_be_told_apart_one_is_told():
    waves = [
        wave_parameters(RECORDS, column, frequency, 1e6)
        for column, frequency in (("supply_pressure", 64.86), ("supply_pressure", 65.52), ("current", 65.52))
    ]
    nominal = SimpleNamespace(parameters=tuple(p for wave in waves for p in wave))
    study = SimpleNamespace(nominal=nominal, session=SimpleNamespace(training=RECORDS))
    assert _waves_apart(study) == [waves[0], waves[2]]


def test_the_gain_of_a_meter_changes_between_records(biased_session):
    """A range switched between records, by 1 %, was a material figure of the torque motor in oil of one temperature."""
    gains = meter_gains(biased_session, "spool_position", IDENTIFICATION)
    assert len(gains) == len(biased_session.training) - 1 and all(map(is_of_meter, gains))
    words = known_faults._gain_words("spool_position")
    amounts = np.linspace(1e-3, 2e-3, len(gains))
    by = 100.0 * np.ptp(contrasts(len(gains) + 1) @ amounts)
    assert words(amounts) == f"the gain of spool_position moves by up to {by:.2g} % between records"


def test_the_zero_of_a_meter_moves_between_records_and_is_told_by_how_much(biased_session):
    """Of more than eight records as well: effects of one name may act so often on a channel."""
    channel, records = "spool_position", biased_session.training
    for count in (len(records), 12):
        many = [replace(records[k % len(records)], name=f"record_{k}") for k in range(count)]
        session = replace(biased_session, records=(*many, *biased_session.locked))
        zeros = meter_zeros(session, channel, IDENTIFICATION)
        assert len(zeros) == count - 1 and all(map(is_of_meter, zeros)) and len({p.name for p in zeros}) == count - 1
        amounts = np.random.default_rng(3).normal(size=count - 1) * zeros[0].deviation
        active = [p.sensor(bias=float(a)) for p, a in zip(zeros, amounts, strict=True)]
        check_listed_once(active)
        offsets = [
            sum(float(active_in(a, r.name).values.bias) for a in active if reads_channel(a.effect, channel, r.name))
            for r in many
        ]
        np.testing.assert_allclose(offsets, contrasts(count) @ amounts)
        words = known_faults._zero_words(channel)(amounts)
        assert words == f"the zero of {channel} moves by up to {value_text(np.ptp(offsets), 'm')} between records"
    (own,) = meter_zeros(biased_session, channel, IDENTIFICATION, records[:1])
    assert active_in(own.sensor(bias=2e-6), records[0].name).values.bias == 2e-6
    assert not reads_channel(own.sensor, channel, records[1].name)


def test_a_meter_that_is_not_linear_is_told_as_the_bench_s_with_how_much(biased_session):
    largest = largest_reading(biased_session, "spool_position")
    words = known_faults._linearity_words("spool_position", biased_session)
    assert words(np.array([0.001, -0.004]) * largest) == (
        "spool_position as read is off a straight line by up to 0.4 % of its largest reading"
    )


def test_clocks_that_run_far_apart_are_told_without_powers_of_ten():
    assert _clock_words(np.array([0.0, -1.26e-3])).endswith("by up to 1260 ppm")
