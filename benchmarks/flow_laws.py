"""Flow-coefficient laws beside Table 3 of the paper and the law of Lichtarowicz: the tables of docs/oils.md.

`python benchmarks/flow_laws.py` prints them as Markdown; a second or so.
"""

import dataclasses
import warnings

import numpy as np

import valvesim as vs
from valvesim.valve import flow_coefficients as flow
from valvesim.valve.equations import NOMINAL
from valvesim.valve.parameters import flow_coefficients_yan_2019

LAW = flow.flow_coefficients_reynolds_number
SLENDERNESS = vs.Valve().fixed_orifice_length / vs.Valve().fixed_orifice_diameter
COLD = (-54.0, -40.0, -30.0, -20.0, 0.0, 20.0, 60.0, 100.0, 200.0, 270.0)


def coefficients(nozzle_number, orifice_number, slenderness=SLENDERNESS):
    """(C of the nozzle, C of the fixed orifice) of the law over the Reynolds number of the moment, at flow numbers."""
    pilot = LAW.pilot(slenderness, 1.0)
    return (
        flow.smooth_flow_coefficient(nozzle_number, pilot.nozzle_loss, pilot.nozzle),
        flow.smooth_flow_coefficient(orifice_number, pilot.orifice_loss + pilot.orifice_wall_loss, pilot.orifice),
    )


def line(*cells) -> None:
    print("| " + " | ".join(map(str, cells)) + " |")


def heading(*cells) -> None:
    line(*cells)
    line(*("---" for _ in cells))


def table_3() -> None:
    """The law at the flow numbers of the paper's CFD case, by Eq. 18, against Table 3."""
    rows, numbers = flow.TABLE_3, flow.table_3_reynolds()
    nozzle, orifice = coefficients(*numbers)
    heading("°C", "flow number nozzle, orifice", "Table 3 nozzle", "law", "error", "Table 3 orifice", "law", "error")
    for k, (t, c_n, c_o) in enumerate(rows):
        weight = " (no weight)" if k == 0 else ""
        line(
            f"{t:g}{weight}", f"{numbers[0][k]:.0f}, {numbers[1][k]:.0f}", f"{c_n:.4f}", f"{nozzle[k]:.4f}",
            f"{100 * (nozzle[k] / c_n - 1):+.1f} %", f"{c_o:.4f}", f"{orifice[k]:.4f}",
            f"{100 * (orifice[k] / c_o - 1):+.1f} %",
        )  # fmt: skip
    ratios = [np.log(number[1] / number[0]) for number in numbers]
    slopes = [np.log(rows[1, k + 1] / rows[0, k + 1]) / ratio for k, ratio in enumerate(ratios)]
    print(f"\nd ln C/d ln Re of Table 3 from -40 to -30 °C: nozzle {slopes[0]:.1f}, fixed orifice {slopes[1]:.1f}; "
          "a smooth law has 1 at most.")  # fmt: skip


def lichtarowicz() -> None:
    """The fixed orifice's law against that of Lichtarowicz, Duggins and Markland."""
    numbers = np.array([10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0, 20000.0])
    heading("L/d", *(f"{n:g}" for n in numbers))
    for slenderness in (2.0, 4.0, 10.0):
        error = coefficients(numbers, numbers, slenderness)[1] / flow.lichtarowicz(numbers, slenderness) - 1.0
        line(f"{slenderness:g}", *(f"{100 * e:+.1f} %" for e in error))
    true = 100.0  # a true Reynolds number: Re = C lambda, the trap
    number = true / 0.5
    for _ in range(50):
        number = true / flow.lichtarowicz(number, 2.0)
    right, wrong = flow.lichtarowicz(number, 2.0), flow.lichtarowicz(true, 2.0)
    print(f"\nAt a true Reynolds number of 100 and L/d 2 his law gives {right:.3f}; with that in the place of the flow "
          f"number it reads {wrong:.3f}.")  # fmt: skip


def null_pressure() -> None:
    """Null pressure and rest at 1 mA of the reference valve over oil temperature, by law."""
    laws = ("yan_2019", "reynolds", "reynolds_number")
    heading("°C", *(f"null pressure {name}, bar" for name in laws), *(f"spool at 1 mA {name}, µm" for name in laws))
    columns = []
    for current, pick, scale in ((0.0, "nozzle_pressure_1", 1e-5), (1e-3, "spool_position", 1e6)):
        for name in laws:
            valve = dataclasses.replace(vs.Valve(), flow_coefficients=flow.FLOW_LAWS[name])
            rest = vs.static_solution(valve, current=current, temperature=np.array(COLD))
            columns.append(scale * getattr(rest, pick))
    for k, t in enumerate(COLD):
        line(f"{t:g}", *(f"{column[k]:.1f}" for column in columns[:3]), *(f"{column[k]:.2f}" for column in columns[3:]))


def eq_19_error() -> None:
    """Eq. 19 at Table 3, for comparison."""
    rows = flow.TABLE_3
    errors = np.abs(np.array(flow_coefficients_yan_2019(rows[:, 0])).T / rows[:, 1:] - 1.0)
    print(f"Eq. 19 meets Table 3 within {100 * errors[:, 0].max():.2f} % and {100 * errors[:, 1].max():.2f} %.")


def pressure_leakage() -> None:
    """What the viscosity's rise with pressure does to the internal leakage at null."""
    heading("°C", "internal leakage at null, L/min", "without the rise", "share")
    held = dataclasses.replace(vs.MIL_PRF_5606, pressure_viscosity_at_40=0.0)
    for t in (-40.0, 20.0, 100.0, 270.0):
        both = []
        for oil in (vs.MIL_PRF_5606, held):
            valve = vs.Valve()
            rest = vs.static_solution(valve, current=0.0, temperature=t, oil=oil)
            c = valve.at(vs.PartTemperatures.uniform(t), oil=oil)
            state = (rest.armature_angle, 0.0, rest.nozzle_pressure_1, rest.nozzle_pressure_2, rest.spool_position, 0.0)
            both.append(float(NOMINAL.signals(state, (0.0, 0.0, 21e6, 0.5e6, 0.0), c).internal_leakage) * 6e4)
        line(f"{t:g}", f"{both[0]:.4f}", f"{both[1]:.4f}", f"{100 * (both[0] / both[1] - 1):+.2f} %")


def main() -> None:
    warnings.simplefilter("ignore")
    parts = (
        ("Against Table 3", table_3), ("Against Lichtarowicz, over the flow number", lichtarowicz),
        ("The reference valve over oil temperature", null_pressure),
        ("Leakage and the viscosity's rise with pressure", pressure_leakage),
    )  # fmt: skip
    for title, part in parts:
        print(f"### {title}\n")
        part()
        print()
    eq_19_error()


if __name__ == "__main__":
    main()
