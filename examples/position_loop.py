"""A position loop around the valve through a launch: cylinder, mass, friction and a proportional controller.

    python examples/position_loop.py [picture.png]

The oil rises from 20 to 270 °C at 3 °C/s and the parts follow by the thermal network. The valve alone has poles to
5e4 rad/s, and python-control takes about 0.6 s for one second of flight; so the loop is run in windows of one second,
where the oil passes each temperature, and not over all 84 s. In each window the cylinder follows a sine, once with a
fixed gain and once with one scheduled over the oil temperature. The schedule is that of a valve at one temperature;
here the torque motor trails the oil, so that some drift is left.

Symbols
    y position m, v velocity m/s, p_L load pressure Pa, Q_L load flow m^3/s, A piston area, V_t volume of both chambers
    m v' = A p_L - B v - F_c tanh(v/v_c),   (V_t/(4 beta)) p_L' = Q_L - A v - C p_L        Merritt (1967), ch. 6
    i = K_p (r - y), within the rated current;  K_p = K_v A/K_q gives the loop the velocity gain K_v
"""

import sys
import time

import control
import matplotlib
import numpy as np

import valvesim as vs
from valvesim.characterisation.control_block import nonlinear_system, rest_state
from valvesim.characterisation.gain_schedule import gain_schedule

AREA, VOLUME, MASS = 1e-3, 1.2e-4, 60.0  # m^2, m^3, kg
VISCOUS, COULOMB, COULOMB_SPEED = 500.0, 100.0, 2e-3  # N s/m, N, m/s
BYPASS = 1e-11  # m^3/s/Pa, a leak between the chambers that damps the load
VELOCITY_GAIN = 40.0  # K_v, 1/s
AMPLITUDE, FREQUENCY, WINDOW = 10e-3, 2.0, 1.0  # m, Hz, s
SCHEDULE_CURRENT = 2e-3  # A: off null, where the port gain is not doubled by the null opening
OIL, RATED = vs.MIL_PRF_5606, 10e-3
LENGTH, PRESSURE = 1e-2, 1e7  # m, Pa: units of two of the actuator's states, so that one tolerance serves all

launch = vs.Scenario(
    duration=90.0, oil_temperature=vs.Ramp(start_value=20.0, end_value=270.0, rate=3.0), thermal=vs.Thermal()
)  # fmt: skip


def actuator() -> control.NonlinearIOSystem:
    """Load flow and oil temperature in; position, velocity and load pressure out."""

    def rates(t, x, u, params):
        v, p = x[1], x[2] * PRESSURE
        beta = OIL.bulk_modulus(u[1], launch.valve.supply_pressure / 2.0)
        force = AREA * p - VISCOUS * v - COULOMB * np.tanh(v / COULOMB_SPEED)
        return np.array([v / LENGTH, force / MASS, 4.0 * beta / VOLUME * (u[0] - AREA * v - BYPASS * p) / PRESSURE])

    def outputs(t, x, u, params):
        return np.array([x[0] * LENGTH, x[1], x[2] * PRESSURE])

    return control.nlsys(
        rates, outputs, name="actuator", states=3, inputs=["load_flow", "oil_temperature"],
        outputs=["position", "velocity", "load_pressure"],
    )  # fmt: skip


def controller(temperatures, flow_gains) -> control.NonlinearIOSystem:
    """Proportional, its gain interpolated over the oil temperature (°C) from the valve's flow gains (m^3/s/A)."""

    def outputs(t, x, u, params):
        gain = VELOCITY_GAIN * AREA / np.interp(u[2], temperatures, flow_gains)
        return np.clip(gain * (u[0] - u[1]), -RATED, RATED)

    return control.nlsys(
        None, outputs, name="controller", inputs=["reference", "position", "oil_temperature"], outputs=["current"]
    )  # fmt: skip


def run(loop, start: float):
    """(time, reference, position, current) of one window that starts at rest at `start` s of the launch."""
    t = start + np.linspace(0.0, WINDOW, 1001)
    reference = AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * (t - start))
    response = control.input_output_response(
        loop, t, reference, [*rest_state(launch, time=start), 0.0, 0.0, 0.0], solve_ivp_method="Radau",
        solve_ivp_kwargs={"rtol": 1e-3, "atol": 1e-4},
    )  # fmt: skip
    position, current = response.outputs
    return t, reference, position, current


def main(picture: str) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = gain_schedule(launch.valve, np.arange(20.0, 271.0, 25.0), current=SCHEDULE_CURRENT)
    temperatures, flow_gains = [row.temperature for row in rows], [row.flow_gain for row in rows]
    valve, load = nonlinear_system(launch), actuator()
    gains = {"fixed gain": [flow_gains[0]] * len(rows), "scheduled gain": flow_gains}
    figure, axes = pyplot.subplots(2, 1, sharex=True, figsize=(8, 8), layout="constrained")
    for name, table in gains.items():
        loop = control.interconnect(
            [valve, load, controller(temperatures, table)], inputs=["reference"],
            outputs=["position", "current"], check_unused=False,
        )  # fmt: skip
        for number, oil in enumerate((20.0, 100.0, 200.0, 270.0)):
            begin, start = time.perf_counter(), (oil - 20.0) / 3.0
            t, reference, position, current = run(loop, start)
            late = t - start >= 1.0 / FREQUENCY  # after the first cycle
            error = (reference - position)[late]
            print(
                f"{name}, oil {oil:3.0f} °C: largest error {np.max(np.abs(error)) * 1e3:.3f} mm, "
                f"rms {np.sqrt(np.mean(error**2)) * 1e3:.3f} mm, current to {np.max(np.abs(current)) * 1e3:.2f} mA "
                f"({time.perf_counter() - begin:.1f} s)"
            )
            style = {"color": f"C{number}", "linestyle": "-" if name == "scheduled gain" else "--"}
            axes[0].plot(t - start, position * 1e3, **style, label=f"{oil:.0f} °C, {name}")
            axes[1].plot(t - start, (reference - position) * 1e3, **style)
    axes[0].plot(t - start, reference * 1e3, "k:", label="reference")
    axes[0].set_ylabel("position, mm")
    axes[1].set_ylabel("error, mm")
    axes[1].set_xlabel("time in the window, s")
    figure.legend(fontsize="small", ncols=3, loc="outside lower center")
    figure.savefig(picture, dpi=120)
    print(f"picture: {picture}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "position_loop.png")
