"""The valve's equations: torque motor, flapper, pilot chambers, spool and main stage (docs/site/physics.md).

Symbols
    theta armature angle, p1 p2 nozzle pressures, x v spool position and velocity, i coil current, N = N_c i
    R1..R4 gap reluctances, Phi flux of a gap pair, T torques, F forces, q flows, r b arms, g1 g2 null gaps
Signs
    i > 0 -> theta > 0 -> the flapper closes nozzle 1 -> p1 > p2 -> x > 0; the rod deflects by (r + b) theta + x.

One source serves floats, numpy arrays (any batch shape) and, through `solver.codegen`, machine code with exact
derivatives: states come in as separate components and a tuple goes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, STATE_CHANNELS, Channel, Inputs, Signals, State
from valvesim.errors import InputError
from valvesim.valve.coefficients import REFERENCE_TEMPERATURE, Coefficients, PartTemperatures
from valvesim.valve.effect import ActiveEffect, Effect, Ports, Situation
from valvesim.valve.laws import (
    MU_0,
    bridge_flux,
    contact_force,
    effective_flow_coefficient,
    laminar_root,
    land_opening,
    magnetic_torque,
    orifice_flow,
    slot_leakage,
)

AT_20 = PartTemperatures.uniform(REFERENCE_TEMPERATURE)
LEAST_GAP = 1e-8  # m, roughness of nozzle and flapper: no smaller hydraulic diameter is seen by the laminar loss
INERTIAS = {"armature_inertia": "armature_rate"}
"""Inertias whose motion is fast, and the velocities whose rates they divide: they stand nowhere else."""
FLOW_FORCE_FACTOR = 0.43  # K_f' = 0.43 w (p_s - p_L): 2 C_d C_v cos 69°, paper Eq. 34


@dataclass(frozen=True)
class CurrentDrive:
    """The command is the coil current."""

    command_name = "current"
    command_unit = "A"
    command_channels: tuple[Channel, ...] = ()  # of the command in a result, where no signal is the same
    memory: tuple[Channel, ...] = ()

    def current(self, u: Inputs, x: State, memory: tuple, c: Coefficients) -> tuple[Any, Any, tuple]:
        """(i, di/dt, rates of the memory)."""
        return u.command, u.command_rate, ()

    def rest(self, command, c: Coefficients) -> tuple:
        """The memory at rest."""
        return ()

    def command_for_current(self, current, coil_resistance):
        """The command that holds a current (A) at rest, through a resistance (ohm)."""
        return current

    def current_for_command(self, command, coil_resistance):
        """The current (A) that a command holds at rest, through a resistance (ohm)."""
        return command


@dataclass(frozen=True)
class VoltageDrive:
    """The command is the voltage over coils and amplifier: L i' = U - R i - K_t theta' (K_t also by reciprocity)."""

    command_name = "voltage"
    command_unit = "V"
    command_channels: tuple[Channel, ...] = (Channel("voltage", "V", "command: over coils and amplifier"),)
    memory: tuple[Channel, ...] = (Channel("drive_current", "A", "current of the voltage drive", 1e-2),)

    def current(self, u: Inputs, x: State, memory: tuple, c: Coefficients) -> tuple[Any, Any, tuple]:
        """(i, di/dt, rates of the memory)."""
        (i,) = memory
        di = (u.command - c.coil_resistance * i - torque_constant(c) * x.armature_rate) / c.coil_inductance
        return i, di, (di,)

    def rest(self, command, c: Coefficients) -> tuple:
        """The memory at rest."""
        return (self.current_for_command(command, c.coil_resistance),)

    def command_for_current(self, current, coil_resistance):
        """The voltage (V) that holds a current (A) at rest, through a resistance (ohm)."""
        return current * coil_resistance

    def current_for_command(self, command, coil_resistance):
        """The current (A) that a voltage (V) holds at rest, through a resistance (ohm)."""
        return command / coil_resistance


def torque_constant(c: Coefficients):
    """K_t = dT_d/di at theta = 0, i = 0 of a symmetric motor, N m/A: b0/(a0 i) of the closed form."""
    l1, l2 = (c.upper_air_gap_1 + c.upper_air_gap_2) / 2, (c.lower_air_gap_1 + c.lower_air_gap_2) / 2
    S = l1 + l2
    X = c.flux_share * S + MU_0 * c.air_gap_area * c.magnet_reluctance
    return (MU_0 * c.air_gap_area * c.polarization_mmf * c.coil_turns * c.armature_arm * c.flux_share * S) / (
        l1 * l2 * X
    )


Drive = CurrentDrive | VoltageDrive
DRIVES: dict[str, Drive] = {drive.command_name: drive for drive in (CurrentDrive(), VoltageDrive())}
"""How the coils are driven, by the name of the command."""


@dataclass(frozen=True)
class Model:
    """The equations with a drive and any effects. Coefficients are a flat sequence: `Coefficients`, then parameters."""

    drive: Drive = CurrentDrive()
    effects: tuple[Effect, ...] = ()

    @property
    def input_channels(self) -> tuple[Channel, ...]:
        """`Inputs`: the command, its rate, and the pressures."""
        return INPUT_CHANNELS

    @property
    def signal_channels(self) -> tuple[Channel, ...]:
        """`Signals`: what `signals` gives, in order."""
        return SIGNAL_CHANNELS

    @property
    def valve_states(self) -> slice:
        """Where the valve's own states stand in a state vector."""
        return slice(0, len(STATE_CHANNELS))

    @property
    def drive_states(self) -> slice:
        """Where the drive's memory stands in a state vector."""
        return slice(self.valve_states.stop, self.valve_states.stop + len(self.drive.memory))

    @property
    def memory_states(self) -> slice:
        """Where the memories of the effects stand in a state vector: behind all others."""
        return slice(self.drive_states.stop, len(self.state_channels))

    @property
    def state_channels(self) -> tuple[Channel, ...]:
        """The states of the valve, then the drive's, then the memory of each effect."""
        return STATE_CHANNELS + self.drive.memory + tuple(m for e in self.effects for m in e.memory)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names in the order of the flat coefficients."""
        return Coefficients._fields + tuple(f"{e.name}.{p.name}" for e in self.effects for p in e.parameters)

    def with_effects(self, effects: Sequence[Effect]) -> Model:
        """The same valve and drive with these effects in the place of its own."""
        return Model(self.drive, tuple(effects))

    def valve_coefficients(self, flat: Sequence) -> Coefficients:
        """The valve's own among flat coefficients, which stand before the parameters of the effects."""
        return Coefficients(*flat[: len(Coefficients._fields)])

    def flat_coefficients(
        self, c: Coefficients, active: Sequence[ActiveEffect], parts: PartTemperatures = AT_20
    ) -> tuple:
        """Coefficients changed by the effects, then the parameters of the effects that the model holds.

        An effect without a balance need not be one of the model's; `parts` are the temperatures that `c` stands for.
        """
        own = [a for a in active if a.effect.balance is not None or a.effect in self.effects]
        if tuple(a.effect for a in own) != self.effects:
            raise InputError("the active effects are not those of the model, in its order")
        for a in active:
            if a.effect.coefficients is not None:
                c = a.effect.coefficients(c, a.values, parts)
        return (*c, *(number for a in own for number in a.numbers))

    def rest(self, inputs: Sequence, c: Coefficients) -> tuple:
        """States at rest under constant `inputs`, in the order of `state_channels`, before effects add to a balance.

        The memories of effects are zero. Components broadcast as `inputs` and `c` do. Raises as `solve_rest` does.
        """
        from valvesim.valve.equilibrium import solve_rest  # which reads these equations

        u = Inputs(*inputs)
        memory = self.drive.rest(u.command, c)
        current = memory[0] if memory else u.command
        at = solve_rest(c, current, 0.0, u.supply_pressure, u.return_pressure, u.load_pressure)
        valve = (at.armature_angle, 0.0, at.nozzle_pressure_1, at.nozzle_pressure_2, at.spool_position, 0.0)
        return (*valve, *memory, *(0.0 for effect in self.effects for _ in effect.memory))

    def rhs(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple:
        """Derivatives of all states, in the order of `state_channels`.

        Each component is a float, an array (components broadcast against each other) or a traced symbol.
        `inputs` are `Inputs`, `coefficients` flat. Valid for any armature angle and spool position: beyond the
        clearances the stops carry. Source: docs/site/physics.md.
        """
        return self.evaluate(state, inputs, coefficients)[0]

    def signals(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> Signals:
        """The named torques, forces, pressures and flows, computed by the same lines as the derivatives."""
        return self.evaluate(state, inputs, coefficients)[1]

    def evaluate(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple[tuple, Signals]:
        """Derivatives and named terms at once; see `rhs`."""
        x, u, c = State(*state[self.valve_states]), Inputs(*inputs), self.valve_coefficients(coefficients)
        i, i_rate, drive_rates = self.drive.current(u, x, tuple(state[self.drive_states]), c)
        added, memory_rates = Ports(), ()
        if self.effects:
            added, memory_rates = self.effects_on(situation_of(x, u, i, i_rate, c), state, coefficients)
        rates, named = valve_equations(x, u, i, c, added)
        return (*rates, *drive_rates, *memory_rates), named

    def situation(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> Situation:
        """What the effects see, before any of them acts."""
        x, u, c = State(*state[self.valve_states]), Inputs(*inputs), self.valve_coefficients(coefficients)
        i, i_rate, _ = self.drive.current(u, x, tuple(state[self.drive_states]), c)
        return situation_of(x, u, i, i_rate, c)

    def memory_rates(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple:
        """The last of the `rhs`, the derivatives of the effects' memories, alone."""
        return self.effects_on(self.situation(state, inputs, coefficients), state, coefficients)[1]

    def effects_on(self, situation: Situation, state: Sequence, coefficients: Sequence) -> tuple[Ports, tuple]:
        """The sum of what the effects add, and the rates of their memories."""
        total, rates = Ports(), ()
        at_state, at_parameter = self.drive_states.stop, len(Coefficients._fields)
        for effect in self.effects:
            memory = tuple(state[at_state : at_state + len(effect.memory)])
            p = effect.values(coefficients[at_parameter : at_parameter + len(effect.parameters)])
            at_state, at_parameter = at_state + len(memory), at_parameter + len(p)
            if effect.balance is not None:
                added, own_rates = effect.balance(situation, p, memory)
                total = Ports(*(a + b for a, b in zip(total, added, strict=True)))
                rates += own_rates
        return total, rates


def valve_equations(x: State, u: Inputs, i, c: Coefficients, added: Ports) -> tuple[tuple, Signals]:
    """Derivatives of the valve's states, and named terms, at a coil current and with what effects add."""
    theta, omega, p1, p2, x_v, v = x
    u = u._replace(
        supply_pressure=u.supply_pressure + added.supply_pressure,
        return_pressure=u.return_pressure + added.return_pressure,
        load_pressure=u.load_pressure + added.load_pressure,
    )

    # torque motor
    N = c.coil_turns * (i + added.coil_current)
    T_drive = drive_torque(theta, N, c)

    # armature with flapper, and feedback rod
    r, b, g1, g2 = c.nozzle_arm, c.feedback_arm, c.null_gap_1, c.null_gap_2
    x_f = r * theta
    F_rod = c.feedback_rod_stiffness * ((r + b) * theta + x_v + added.rod_deflection)
    T_damping = -c.armature_damping * omega
    T_tube = -c.spring_tube_stiffness * theta
    T_rod = -(r + b) * F_rod
    T_nozzles, T_jets = flapper_torques(theta, p1, p2, u.supply_pressure, u.return_pressure, c)
    T_stop = r * contact_force(x_f, r * omega, -g2, g1, c.flapper_stop_stiffness, c.stop_damping)
    torque = T_drive + T_damping + T_tube + T_rod + T_nozzles + T_jets + T_stop + added.armature_torque

    # pilot stage
    q_01 = fixed_orifice_flow(c.fixed_orifice_diameter_1, u.supply_pressure - p1, c)
    q_02 = fixed_orifice_flow(c.fixed_orifice_diameter_2, u.supply_pressure - p2, c)
    q_n1, q_n2 = nozzle_flows(x_f, p1, p2, u.return_pressure, c)
    compliance_1 = 1.0 / (c.bulk_modulus_at_zero + c.bulk_modulus_slope * p1) + added.compliance_1
    compliance_2 = 1.0 / (c.bulk_modulus_at_zero + c.bulk_modulus_slope * p2) + added.compliance_2

    # spool
    F_pressure = c.spool_area * (p1 - p2)
    F_flow = -FLOW_FORCE_FACTOR * c.port_width * (u.supply_pressure * x_v - u.load_pressure * np.abs(x_v))
    F_damping = -c.spool_damping * v
    F_stop = contact_force(x_v, v, -c.spool_stroke, c.spool_stroke, c.spool_stop_stiffness, c.stop_damping)
    force = F_pressure - F_rod + F_flow + F_damping + F_stop + added.spool_force

    rates = (
        omega,
        torque / c.armature_inertia,
        (q_01 - q_n1 - c.spool_area * v + added.chamber_flow_1) / (c.chamber_volume * compliance_1),
        (q_02 - q_n2 + c.spool_area * v + added.chamber_flow_2) / (c.chamber_volume * compliance_2),
        v,
        force / c.spool_mass,
    )
    load_flow, land_leakage = main_stage(x_v, u.supply_pressure, u.load_pressure, c)
    named = Signals(
        current=i,
        drive_torque=T_drive,
        flapper_position=x_f,
        feedback_force=F_rod,
        flow_force=F_flow,
        pilot_differential_pressure=p1 - p2,
        pilot_flow=q_01 + q_02,
        nozzle_flow_1=q_n1,
        nozzle_flow_2=q_n2,
        load_flow=load_flow + added.load_flow,
        internal_leakage=q_01 + q_02 + land_leakage + added.internal_leakage,
    )
    return rates, named


def situation_of(x: State, u: Inputs, current, current_rate, c: Coefficients) -> Situation:
    """What the effects see, before any of them acts."""
    load_flow, _ = main_stage(x.spool_position, u.supply_pressure, u.load_pressure, c)
    x_f = c.nozzle_arm * x.armature_angle
    nozzles = nozzle_flows(x_f, x.nozzle_pressure_1, x.nozzle_pressure_2, u.return_pressure, c)
    return Situation(x, u, current, current_rate, load_flow, *nozzles, c)


def drive_torque(theta, N, c: Coefficients):
    """T_d of the torque motor at angle theta and coil magnetomotive force N, N m, in closed form."""
    R1 = (c.upper_air_gap_1 - c.armature_arm * theta) / (MU_0 * c.air_gap_area)
    R2 = (c.upper_air_gap_2 + c.armature_arm * theta) / (MU_0 * c.air_gap_area)
    R3 = (c.lower_air_gap_2 - c.armature_arm * theta) / (MU_0 * c.air_gap_area)
    R4 = (c.lower_air_gap_1 + c.armature_arm * theta) / (MU_0 * c.air_gap_area)
    Phi = bridge_flux(c.polarization_mmf, N, R1, R2, R3, R4, c.magnet_reluctance, c.flux_share)
    return magnetic_torque(Phi, N, R1, R2, R3, R4, c.armature_arm, c.air_gap_area)


def flapper_torques(theta, p1, p2, supply_pressure, return_pressure, c: Coefficients) -> tuple[Any, Any]:
    """(torque of the nozzle pressures, torque of the jets) on the flapper, N m (paper Eq. 33).

    The jets push with 4 pi C_df^2 (gap)^2 p each; at p = p_s/2 and with one C_df their difference is
    2 pi C_df^2 p_s (g1 + g2)(g1 - g2 - 2 r theta), which is Eq. 33's term where the gaps are equal. Each jet has the
    flow coefficient of its own gap: below, C_df g is the mean of both sides and their difference.
    """
    r, g1, g2 = c.nozzle_arm, c.null_gap_1, c.null_gap_2
    A_N1, A_N2 = np.pi * c.nozzle_diameter_1**2 / 4.0, np.pi * c.nozzle_diameter_2**2 / 4.0
    T_nozzles = -r * (A_N1 * (p1 - return_pressure) - A_N2 * (p2 - return_pressure))
    x_1, x_2 = g1 - r * theta, g2 + r * theta
    C_1, C_2 = (
        effective_flow_coefficient(
            c.nozzle_flow_coefficient, supply_pressure / 2.0, c.transition_pressure, nozzle_laminar_root(x, c)
        )
        for x in (x_1, x_2)
    )
    jets = 2.0 * np.pi * r * supply_pressure
    return T_nozzles, jets * (C_2 * x_2 - C_1 * x_1) * (C_2 * x_2 + C_1 * x_1)


def fixed_orifice_flow(diameter, pressure_drop, c: Coefficients):
    """Flow through a fixed orifice, m^3/s: D_h = d, laminar loss k1 = k_hole + k_wall l_0/d (both zero by Eq. 19)."""
    area = np.pi * diameter**2 / 4.0 * c.orifice_flow_coefficient
    loss = (c.orifice_laminar_loss * diameter + c.orifice_wall_loss) / (diameter * diameter)
    root = laminar_root(c.orifice_flow_coefficient, loss, c.dynamic_viscosity, c.density)
    return orifice_flow(area, pressure_drop, c.density, c.transition_pressure, root)


def nozzle_laminar_root(gap, c: Coefficients):
    """b of `laws.orifice_flow` of the curtain between nozzle and flapper: D_h is twice the gap."""
    loss = c.nozzle_laminar_loss / (2.0 * np.maximum(gap, LEAST_GAP))
    return laminar_root(c.nozzle_flow_coefficient, loss, c.dynamic_viscosity, c.density)


def nozzle_flow(diameter, gap, pressure_drop, c: Coefficients):
    """Flow out of a nozzle, m^3/s: curtain area pi d_n times the gap that the flapper leaves, none once closed."""
    area = np.pi * diameter * np.maximum(gap, 0.0) * c.nozzle_flow_coefficient
    return orifice_flow(area, pressure_drop, c.density, c.transition_pressure, nozzle_laminar_root(gap, c))


def nozzle_flows(x_f, p1, p2, return_pressure, c: Coefficients) -> tuple[Any, Any]:
    """(q_n1, q_n2) out of the nozzles with the flapper at x_f, m^3/s."""
    return (
        nozzle_flow(c.nozzle_diameter_1, c.null_gap_1 - x_f, p1 - return_pressure, c),
        nozzle_flow(c.nozzle_diameter_2, c.null_gap_2 + x_f, p2 - return_pressure, c),
    )


def main_stage(x_v, supply_pressure, load_pressure, c: Coefficients) -> tuple[Any, Any]:
    """(load flow, leakage past the lands), m^3/s, of four lands with port pressures (p_s +- p_L)/2.

    Wide open this is Q_L = C_d w x sqrt((p_s - sign(x) p_L)/rho); the leakage is what passes the closing
    land of each port, for |p_L| <= p_s. The main return is at zero pressure, as in the paper. Every land opens once the
    spool has passed its overlap (negative: underlap).
    """
    p_A, p_B = (supply_pressure + load_pressure) / 2.0, (supply_pressure - load_pressure) / 2.0

    def land(travel, pressure_drop):
        opening = travel - c.land_overlap
        area = c.port_flow_coefficient * c.port_width * land_opening(opening, c.null_opening)
        length = c.land_length + np.maximum(-opening, 0.0)
        return orifice_flow(area, pressure_drop, c.density, c.transition_pressure) + slot_leakage(
            c.spool_circumference, c.radial_clearance, length, c.dynamic_viscosity, pressure_drop
        )

    q_PA, q_AT = land(x_v, supply_pressure - p_A), land(-x_v, p_A)
    q_PB, q_BT = land(-x_v, supply_pressure - p_B), land(x_v, p_B)
    return q_PA - q_AT, np.minimum(q_PA, q_AT) + np.minimum(q_PB, q_BT)


NOMINAL = Model()
