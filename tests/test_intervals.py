"""Confidence intervals of what was fitted: what the records know of a figure, and where their parts disagree."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import erf

from valvesim.diagnosis.intervals import confidence_intervals
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.fit_jacobian import perturbation
from valvesim.identification.prior import NETWORK, NuisanceParameter
from valvesim.identification.projection import GramMatrix
from valvesim.valve.catalogue import CATALOGUE

SEGMENTS, ROWS = 60, 50
NOISE = np.random.default_rng(4).normal(size=(SEGMENTS, ROWS))


def interval(name="spool_area", unit="m^2", nominal=2.0, apart=0.0):
    """The interval of a figure, its deviation 0.1 of which a unit shows 4 in every row, that a fit has 3 deviations out
    by its own amplitude and 1 by the nuisance parameter; segments may say that it is `apart` units more or less.
    """
    parameter = NuisanceParameter(name, unit, nominal, 0.1, (0.1, 10.0))
    member = FittedCandidate(Candidate(f"parameter:{name}", parameter=parameter), 0.3)
    products = []
    for k, noise in enumerate(NOISE):
        unit_shows = np.full(ROWS, 4.0)
        columns = np.column_stack(
            [noise + (-1.0) ** k * apart * unit_shows, 0.1 * unit_shows, perturbation(member) * unit_shows]
        )
        products.append(columns.T @ columns)
    fit = Fit(np.ones(1), (member,), 0.0, (), np.zeros(0), float(SEGMENTS * ROWS))
    final = SimpleNamespace(
        fit=fit, own=(0,), options=DIAGNOSIS, gram=GramMatrix(np.array(products), np.ones(1), (ROWS,) * SEGMENTS)
    )
    model = SimpleNamespace(parameters=(parameter,))
    (found,) = confidence_intervals(SimpleNamespace(study=SimpleNamespace(nominal=model)), final)
    return found


def test_a_figure_beyond_its_tolerance_is_told_as_it_is_however_it_was_shared():
    found = interval()
    assert (found.name, found.cause, found.unit, found.doc) == ("spool_area", "parameter:spool_area", "m^2", "")
    assert found.value == pytest.approx(2.0 + 0.3 + 0.1)
    known = 1.96 / (4.0 * np.sqrt(SEGMENTS * ROWS))  # by the rows alone: not by the prior, nor by how it was shared
    assert found.high - found.value == pytest.approx(known, rel=0.15)
    assert found.value - found.low == pytest.approx(found.high - found.value)


def test_parts_that_disagree_widen_the_interval():
    assert interval(apart=0.2).high - interval().value > 3.0 * (interval().high - interval().value)


def test_a_figure_of_the_heat_paths_is_told_in_words():
    assert interval(f"{NETWORK}oil_to_spool", "W/K").doc == "heat transfer from oil to spool"


def test_what_another_law_would_say_of_an_amplitude_widens_its_interval_and_none_is_taken_for_the_plants():
    def half(law_error, figure_error=0.0):
        effect = replace(CATALOGUE["magnetic_hysteresis"], law_error=law_error, figure_error=figure_error)
        member = FittedCandidate(Candidate("magnetic_hysteresis", effect=effect), 2e-4)
        shows = np.column_stack([NOISE[0], np.zeros(ROWS), perturbation(member) * np.full(ROWS, 1e8)])
        gram = GramMatrix(np.array([shows.T @ shows] * 2), np.ones(1), (ROWS,) * 2)
        fit = Fit(np.zeros(1), (member,), 0.0, (), np.zeros(0), 2.0 * ROWS)
        model = SimpleNamespace(parameters=(NuisanceParameter("spool_area", "m^2", 2.0, 0.1, (0.1, 10.0)),))
        final = SimpleNamespace(fit=fit, own=(0,), options=DIAGNOSIS, gram=gram)
        found = confidence_intervals(SimpleNamespace(study=SimpleNamespace(nominal=model)), final)[0]
        return found.high - found.value

    least = DIAGNOSIS.selection.least_law_error
    of_the_rows = np.sqrt(half(0.0) ** 2 - least * 2e-4**2)
    assert half(0.2) == pytest.approx(np.hypot(of_the_rows, np.sqrt(0.2) * 2e-4), rel=1e-6)
    assert half(0.0) == half(least) > np.sqrt(least) * 2e-4
    assert half(0.0, 0.3) == pytest.approx(np.hypot(of_the_rows, 0.3 * 2e-4), rel=1e-6)


@pytest.mark.parametrize("step", [lambda r: 0.5 * (1.0 + np.tanh(4.0 * (r - 1.0))),
                                  lambda r: 0.5 * (1.0 + erf(2.0 * np.sqrt(np.pi) * (r - 1.0)))])  # fmt: skip
def test_a_cavitation_by_another_step_as_steep_has_figures_that_are_other_by_its_figure_error_at_most(step):
    """The steps have the slope of r^8/(1 + r^8) at r = 1; the figures are those that fit best over what is seen."""
    off = []
    for low, high in ((0.9, 1.1), (0.85, 1.05), (0.95, 1.2), (0.7, 1.3)):
        r = np.linspace(low, high, 200)
        loss, critical = least_squares(lambda p, r=r: p[0] / (1.0 + (p[1] / r) ** 8) - step(r), [1.0, 1.0]).x
        off += [abs(loss - 1.0), abs(critical - 1.0)]
    assert 0.8 * CATALOGUE["flapper_cavitation"].figure_error < max(off)
    assert max(off) < 1.1 * CATALOGUE["flapper_cavitation"].figure_error
