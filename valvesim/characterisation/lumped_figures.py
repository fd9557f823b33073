"""The valve's own lumps at null, and its figures of merit beside those published for its class."""

from __future__ import annotations

import numpy as np

from valvesim.characterisation.class_figures import ClassFigure, class_figures
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit
from valvesim.characterisation.held_scenario import Source, held, held_oil_temperature
from valvesim.characterisation.response_set import ResponseSet
from valvesim.inputs import evaluate
from valvesim.valve.equations import drive_torque
from valvesim.valve.equilibrium import solve_rest
from valvesim.valve.thermal_network import starting_temperatures


def beside_class(source: Source, one: ResponseSet) -> tuple[tuple[ClassFigure, FigureOfMerit | Absent], ...]:
    """Each published figure of the class with the valve's own: its lumps, its largest step, its sweep next to 25 %.

    Figures that the set has no test for are `Absent`. Raises as `lumped_figures` does.
    """
    own: dict[str, FigureOfMerit | Absent] = {
        f.name: f for f in lumped_figures(source, oil_temperature=one.oil_temperature)
    }
    if one.sweeps:
        own.update({f.name: f for f in min(one.sweeps, key=lambda sweep: abs(sweep.share - 0.25)).figures})
    if one.steps:
        own.update({f.name: f for f in max(one.steps, key=lambda step: abs(step.share)).figures})
    return tuple((f, own.get(f.name, Absent(f.name, "no test of the set gives it"))) for f in class_figures())


def lumped_figures(source: Source, *, oil_temperature: float | None = None) -> tuple[FigureOfMerit, ...]:
    """The valve's own lumps at null, as NASA TN D-5388 defines them, to set beside `class_figures`.

    With K = K_s - dT_d/dtheta the net stiffness of tube and magnets and Q = pi d_n C_df sqrt(2 (p_1 - p_0)/rho) the
    flow of a nozzle per flapper displacement:

    - armature_frequency, Hz: sqrt(K/J)/(2 pi)
    - loop_gain, 1/s: Q K_f (r + b) r/(A_v K), of flapper, spool and feedback rod
    - speed_limit, m/s: Q x_f0/A_v, of the spool with the flapper on a nozzle, at the chambers' pressures of null

    Valid for a valve with (nearly) equal sides. Raises as `static_solution` does.
    """
    base = held(source, oil_temperature=oil_temperature)
    T = held_oil_temperature(base)
    parts = base.thermal.initial_temperature if base.thermal.network is not None else None
    temperatures = starting_temperatures(parts, T)
    c = base.valve.at(temperatures, oil=base.oil, routes=base.thermal.routes)
    pressures = [float(evaluate(command, 0.0)) for command in base.pressures()]
    rest = solve_rest(c, np.asarray(0.0), T, *pressures)
    theta, turn = float(rest.armature_angle), 1e-6
    magnetic = (drive_torque(theta + turn, 0.0, c) - drive_torque(theta - turn, 0.0, c)) / (2.0 * turn)
    stiffness = float(c.spring_tube_stiffness - magnetic)
    drop = (rest.nozzle_pressure_1 + rest.nozzle_pressure_2) / 2.0 - pressures[1]
    flow = float(np.pi * c.nozzle_diameter_1 * c.nozzle_flow_coefficient * np.sqrt(2.0 * drop / c.density))
    arms = c.feedback_rod_stiffness * (c.nozzle_arm + c.feedback_arm) * c.nozzle_arm
    frequency = float(np.sqrt(stiffness / c.armature_inertia)) / (2.0 * np.pi)
    return (
        FigureOfMerit("armature_frequency", frequency, "Hz", "armature on spring tube and magnets"),
        FigureOfMerit(
            "loop_gain", float(flow * arms / (c.spool_area * stiffness)), "1/s", "flapper, spool and feedback rod"
        ),
        FigureOfMerit(
            "speed_limit", float(flow * c.null_gap_1 / c.spool_area), "m/s", "spool with the flapper on a nozzle"
        ),
    )
