"""An effect with a `figure` is the valve with that quantity off: the search takes them for one hypothesis."""

import numpy as np
import pytest

from valvesim.units import quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import AT_20
from valvesim.valve.parameters import Valve

NAMED = {name: effect for name, effect in CATALOGUE.items() if effect.figure}
SIDED = ("fixed_orifice_clogging", "nozzle_erosion")  # they change the mean of both sides too


def slopes(change):
    """Relative change of each coefficient by a small change of the valve."""
    before = np.array([float(v) for v in Valve().at(AT_20)])
    after = np.array([float(v) for v in change])
    return (after - before) / np.where(before == 0.0, 1e-6, before)


@pytest.mark.parametrize("name", NAMED)
def test_the_figure_is_one_of_the_valves(name):
    assert NAMED[name].figure in quantities(Valve)


@pytest.mark.parametrize("name", [name for name in NAMED if name not in (*SIDED, "coil_turns_loss")])
def test_the_effect_is_that_figure_off(name):
    effect = NAMED[name]
    amplitude = effect.amplitude
    active = effect(**{amplitude.name: 1e-4 * amplitude.typical})
    by_effect = slopes(effect.coefficients(Valve().at(AT_20), active.values, AT_20))
    nominal = float(getattr(Valve(), effect.figure))
    step = 1e-4 * (nominal if nominal else 1e-6)
    by_figure = slopes(Valve(**{effect.figure: nominal + step}).at(AT_20))
    along = by_effect @ by_figure / np.linalg.norm(by_effect) / np.linalg.norm(by_figure)
    assert abs(along) == pytest.approx(1.0, abs=1e-6)
