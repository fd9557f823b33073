"""A scenario: valve, oil, temperatures, commands, effects and outputs; what does not go together is refused.

Keys in errors are those of a scenario file (`scenario_toml`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from valvesim.errors import InputError, unknown_name, warn_once
from valvesim.inputs import PIECE_WIDTH, Command, Constant, Scaled, Sum, as_command, evaluate, extremes, turns
from valvesim.io import check_printable, write_atomically, write_text
from valvesim.shown import Shown
from valvesim.units import POSITIVE, check_bounds, has_unit, in_si, quantities, quantity
from valvesim.valve.coefficients import ROUTES, check_routes
from valvesim.valve.effect import ActiveEffect, check_listed_once
from valvesim.valve.equations import CurrentDrive, Drive, Model
from valvesim.valve.fluid import COMPUTED_RANGE, MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import (
    THERMAL_NODES,
    TemperaturePath,
    ThermalNetwork,
    temperature_path,
    throttling_rise,
)
from valvesim.valve.valve_name import valve_name

MOST_SAMPLES = 2e7  # of a result: 5 GB
MOST_OIL_PIECES, MOST_OIL_TURNS = 100_000, 2_000  # of the oil temperature: each takes knots of every coefficient


@dataclass(frozen=True, kw_only=True)
class Thermal:
    """How the parts follow the oil. `network` None is isothermal; `routes` are the temperature routes that act.

    `initial_temperature` is where the parts start, °C: one for all, or by part (names of `THERMAL_NODES`); a part
    that is left out, or all of them with None, starts with the oil.
    """

    network: ThermalNetwork | None = ThermalNetwork()
    routes: tuple[str, ...] = ROUTES
    throttling_heat: bool = False
    ambient_temperature: float = quantity(20.0, "degC", "air around the valve", (-100.0, 400.0), "")
    initial_temperature: float | Mapping[str, float] | None = None

    def __post_init__(self):
        check_bounds(self)
        check_routes(self.routes)
        low, high = quantities(self)["ambient_temperature"].metadata["bounds"]
        self._read_initial_temperature()
        given = self.initial_temperature
        for name, value in given.items() if isinstance(given, Mapping) else (("every part", given),):
            if name not in THERMAL_NODES and name != "every part":
                raise unknown_name("part", name, THERMAL_NODES, "thermal.initial_temperature")
            if value is not None and not low <= value <= high:
                key = f".{name}" if name in THERMAL_NODES else ""
                raise InputError(
                    f"{value:.6g} °C is outside [{low:g}, {high:g}] °C ({name.replace('_', ' ')} at the start)",
                    key=f"thermal.initial_temperature{key}", joint=" = ",
                )  # fmt: skip

    def _read_initial_temperature(self) -> None:
        """What is given as text or quantity becomes °C."""
        given, where = self.initial_temperature, "thermal.initial_temperature"
        if isinstance(given, Mapping):
            if any(has_unit(value) for value in given.values()):
                read = {name: in_si(value, "degC", f"{where}.{name}") for name, value in given.items()}
                object.__setattr__(self, "initial_temperature", read)
        elif has_unit(given):
            object.__setattr__(self, "initial_temperature", in_si(given, "degC", where))


@dataclass(frozen=True, kw_only=True, repr=False)
class Scenario(Shown):
    """Everything that a run needs, in SI; temperatures in °C. Pressures default to the valve's own.

    `part_temperatures` has, by part (names of `THERMAL_NODES`), those that are prescribed, as measured say; the others
    follow.
    A number, text with a unit ("5 mA") or a quantity of pint in place of a command is a constant one.
    """

    title: str = "valve"
    duration: float = quantity(1.0, "s", "duration of the run", (POSITIVE, 1e5), "")
    valve: Valve = field(default_factory=Valve)
    oil: Oil = MIL_PRF_5606
    thermal: Thermal = field(default_factory=Thermal)
    oil_temperature: Command = Constant(value=20.0)
    part_temperatures: Mapping[str, Command] = field(default_factory=dict)
    command: Command = Constant(value=0.0)
    drive: Drive = CurrentDrive()
    supply_pressure: Command | None = None
    return_pressure: Command | None = None
    load_pressure: Command | None = None
    effects: tuple[ActiveEffect, ...] = ()
    output_rate: float = quantity(1000.0, "Hz", "output samples per second", (POSITIVE, 1e7), "")
    channels: tuple[str, ...] = ()
    tolerance: float = quantity(5e-5, "1", "relative tolerance of the integration", (1e-10, 1e-2), "")

    def __post_init__(self):
        check_bounds(self)
        check_printable(self.title, "title")
        self._read_commands()
        check_listed_once(self.effects)
        for name in ("supply", "return", "load"):
            if np.ndim(getattr(self.valve, f"{name}_pressure")):
                problem = f"is an array: the valves of a batch run at one {name} pressure"
                raise InputError(problem, key=f"valve.{name}_pressure", joint=" ")
        self._check_sizes()
        self._check_pressures()
        self._check_oil_temperature()

    def _read_commands(self) -> None:
        """What is no command yet becomes a constant one."""
        drive = self.drive
        units = {"command": (drive.command_unit, f"command.{drive.command_name}"),
                 "oil_temperature": ("degC", "thermal.oil_temperature")}  # fmt: skip
        units |= {f"{name}_pressure": ("Pa", f"pressures.{name}") for name in ("supply", "return", "load")}
        for name, (unit, where) in units.items():
            given = getattr(self, name)
            optional = name.endswith("_pressure") and given is None
            if not optional and (read := as_command(given, unit, where)) is not given:
                object.__setattr__(self, name, read)
        for part in self.part_temperatures:
            if part not in THERMAL_NODES:
                raise unknown_name("part", part, THERMAL_NODES, "thermal.part_temperatures")
        parts = {
            part: as_command(given, "degC", f"thermal.part_temperatures.{part}")
            for part, given in self.part_temperatures.items()
        }
        object.__setattr__(self, "part_temperatures", parts)

    def _temperatures(self) -> dict[str, Command]:
        """The temperatures that are commanded, by their keys."""
        parts = {f"thermal.part_temperatures.{part}": command for part, command in self.part_temperatures.items()}
        return {"thermal.oil_temperature": self.oil_temperature, **parts}

    def _check_sizes(self) -> None:
        """Bounds on what a run holds in memory, before any of it is made."""
        end = self.duration
        if end * self.output_rate > MOST_SAMPLES:
            raise InputError(
                f"{self.output_rate:g} Hz over {end:g} s makes more than {MOST_SAMPLES:g} samples; lower the rate or "
                "the duration", key="outputs.rate", related=("duration",),
            )  # fmt: skip
        temperatures, pressures = self._temperatures(), zip(("supply", "return", "load"), self.pressures(), strict=True)
        given = {f"command.{self.drive.command_name}": self.command, **temperatures}
        for where, command in (given | {f"pressures.{name}": pressure for name, pressure in pressures}).items():
            try:
                rows = command.pieces(end)
            except InputError as error:
                raise error.moved("", where) from None
            if where in temperatures:
                count = np.count_nonzero(rows[:, 0] < end)
                if count > MOST_OIL_PIECES:
                    raise InputError(f"{count} pieces are more than {MOST_OIL_PIECES}", key=where)
                if rows.shape[1] > PIECE_WIDTH and (waves := turns(rows, end)) > MOST_OIL_TURNS:
                    problem = f"{waves:.4g} periods within {end:g} s are more than {MOST_OIL_TURNS}"
                    raise InputError(problem, key=where)

    def _check_pressures(self) -> None:
        """None may ever be negative, the return never above the supply, nor the load beyond it; at each instant."""
        end, (supply, back, load) = self.duration, self.pressures()
        commands = {"supply": supply, "return": back, "load": load}
        reach = {name: extremes(command, end) for name, command in commands.items()}
        for name in ("supply", "return"):
            if not reach[name].lowest >= 0.0:
                raise InputError(
                    f"{reach[name].lowest / 1e5:.4g} bar at t = {reach[name].lowest_at:.6g} s is negative; it is "
                    "absolute", key=f"pressures.{name}",
                )  # fmt: skip
        try:
            _ = self.valve_at_start
        except InputError as error:
            raise InputError(f"at the start of the run, {error}", key="pressures", related=error.keys) from None
        least = reach["supply"].lowest
        if least > reach["return"].highest and least >= max(reach["load"].highest, -reach["load"].lowest):
            return  # never near each other, whatever the instant
        drop = extremes(Sum((supply, Scaled(back, -1.0))), end)
        if not drop.lowest > 0.0:
            above = f"{-drop.lowest / 1e5:.4g} bar above" if drop.lowest < 0.0 else "at"
            raise InputError(f"{above} the supply pressure at t = {drop.lowest_at:.6g} s", key="pressures.return")
        room = 1e-9 * float(np.max(np.abs(supply.pieces(end)[:, 1])))  # rounding
        for side in (-1.0, 1.0):
            left = extremes(Sum((supply, Scaled(load, side))), end)
            if not left.lowest >= -room:
                raise InputError(
                    f"{-left.lowest / 1e5:.4g} bar beyond the supply pressure at t = {left.lowest_at:.6g} s",
                    key="pressures.load",
                )

    def _check_oil_temperature(self) -> None:
        """It may never leave what the laws of the oil are computed for, nor may a part."""
        low, high = COMPUTED_RANGE
        for where, command in self._temperatures().items():
            reach = extremes(command, self.duration)
            for value, when in ((reach.highest, reach.highest_at), (reach.lowest, reach.lowest_at)):
                if not low <= value <= high:
                    raise InputError(
                        f"oil {self.oil.name}: {value:.4g} °C at t = {when:.6g} s is outside {low:g} to {high:g} °C, "
                        "beyond which no law of the oil is computed", key=where,
                    )  # fmt: skip

    @property
    def valve_at_start(self) -> Valve:
        """The valve at the pressures that are commanded at the start, for what is static."""
        supply, back, load = (float(evaluate(pressure, 0.0)) for pressure in self.pressures())
        return dataclasses.replace(self.valve, supply_pressure=supply, return_pressure=back, load_pressure=load)

    @property
    def model(self) -> Model:
        """The equations that this scenario integrates: effects without a balance act before them or after."""
        acting = [active.effect for active in self.effects]
        return Model(self.drive, tuple(effect for effect in acting if effect.balance is not None))

    def in_words(self) -> str:
        """Title, duration, oil and valve on one line."""
        return f"{self.title!r}, {self.duration:g} s, oil {self.oil.name}, {valve_name(self.valve)}"

    def to_toml(self, path: str | Path | None = None) -> str:
        """The text of a scenario file that reads back as an equal scenario; also written to `path` where one is given.

        Raises InputError for what no file can say (`scenario_to_toml`), and for a path that cannot be written.
        """
        from valvesim.simulation.scenario_toml import scenario_to_toml

        text = scenario_to_toml(self)
        if path is not None:
            write_atomically(Path(path), lambda temporary: write_text(temporary, text))
        return text

    def pressures(self) -> tuple[Command, Command, Command]:
        """Supply, return and load pressure over time."""
        given = (self.supply_pressure, self.return_pressure, self.load_pressure)
        own = (self.valve.supply_pressure, self.valve.return_pressure, self.valve.load_pressure)
        return tuple(  # type: ignore[return-value]
            Constant(value=value) if command is None else command for command, value in zip(given, own, strict=True)
        )

    def throttling(self):
        """The oil's temperature rise by throttling as a function of °C, or None where it is off; drop of the start."""
        if not self.thermal.throttling_heat:
            return None
        valve = self.valve_at_start
        return throttling_rise(self.oil, valve.supply_pressure - valve.return_pressure)

    def temperatures(self, *, spacing: float = 0.1, knots: np.ndarray | None = None) -> TemperaturePath:
        """Oil and part temperatures of the run on `knots`, or on some at most `spacing` s apart."""
        thermal = self.thermal
        path = temperature_path(
            self.oil_temperature,
            self.duration,
            network=thermal.network,
            initial=thermal.initial_temperature,
            ambient=thermal.ambient_temperature,
            throttling=self.throttling(),
            spacing=spacing,
            knots=knots,
            prescribed=self.part_temperatures,
        )
        prescribed = {name: getattr(path.parts, name) for name in self.part_temperatures}  # no effect is upon them
        for active in self.effects:
            if active.effect.temperatures is not None:
                parts = active.effect.temperatures(path.times, path.parts, active.values)
                path = dataclasses.replace(path, parts=dataclasses.replace(parts, **prescribed))
        return path

    def warn_of_large_command(self) -> None:
        """Warn once where the command goes beyond the rated current."""
        reach, rated = extremes(self.command, self.duration), self.valve.rated_current
        top, when = max((-reach.lowest, reach.lowest_at), (reach.highest, reach.highest_at))
        top = self.drive.current_for_command(top, np.min(self.valve.coil_resistance))
        if top > np.min(rated) * (1 + 1e-9):
            warn_once(
                f"command: up to {top * 1e3:.4g} mA (t = {when:.4g} s) is beyond the rated current of "
                f"{np.min(rated) * 1e3:.4g} mA; spool and flapper may reach their stops"
            )
