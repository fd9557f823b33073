"""Headings of columns: a name and a unit in any of the forms in use, and the channel that a name stands for.

A column is recognised by the channel's own name, however it is capitalised and joined (`Spool Position`), or by one of
`ALIASES`; in both the unit must be of the channel's dimension.
"""

from __future__ import annotations

import re
import unicodedata

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, STATE_CHANNELS
from valvesim.errors import InputError
from valvesim.measurement.table import Heading
from valvesim.units import convert

MEASURED_UNITS = {
    "time": "s", "voltage": "V", "pressure_drop": "Pa",
    **{
        f"{part}_temperature": "degC"
        for part in ("oil", "body", "torque_motor", "pilot_metal", "spool", "sleeve", "spring_tube", "feedback_rod")
    },
    **{c.name: c.unit for c in (*STATE_CHANNELS, *INPUT_CHANNELS[2:], *SIGNAL_CHANNELS)},
}  # fmt: skip
"""Every channel that a measurement can have, with the unit in which it is handed on."""

ALIASES = {
    "time": ("t", "zeit", "elapsed time", "time stamp", "timestamps", "date time", "datetime", "uhrzeit", "datum zeit"),
    "current": ("i", "strom", "coil current", "input current", "command current", "spulenstrom"),
    "voltage": ("spannung", "coil voltage", "drive voltage", "command voltage"),
    "oil_temperature": ("oil temp", "t oil", "fluid temperature", "öltemperatur", "oeltemperatur"),
    "pilot_metal_temperature": ("pilot temperature", "nozzle temperature"),
    "feedback_rod_temperature": ("rod temperature",),
    "torque_motor_temperature": ("motor temperature",),
    "supply_pressure": ("p supply", "ps", "system pressure", "versorgungsdruck", "systemdruck"),
    "return_pressure": ("p return", "pr", "tank pressure", "tankdruck", "rücklaufdruck"),
    "load_pressure": ("p load", "pl", "lastdruck"),
    "pressure_drop": ("valve pressure drop", "druckabfall"),
    "spool_position": ("spool", "xv", "spool displacement", "spool stroke", "schieberweg", "schieberposition"),
    "load_flow": ("flow", "q", "ql", "control flow", "volumenstrom", "durchfluss"),
    "internal_leakage": ("leakage", "leak flow", "leakage flow", "leckage", "leckölstrom"),
}
"""Other names in use, as `plain` writes them but for capitals, spaces and signs."""

_SPELLED = {
    "m3s": "m^3/s", "m3/s": "m^3/s", "m³/s": "m^3/s", "lmin": "L/min", "lpm": "L/min", "l/m": "L/min",
    "gpm": "gal/min", "cis": "in^3/s", "grad c": "degC",
    "c": "degC", "°c": "degC", "ºc": "degC", "deg c": "degC", "°f": "degF", "deg f": "degF", "sec": "s", "sek": "s",
    "msec": "ms", "usec": "us", "amp": "A", "amps": "A", "volt": "V", "volts": "V", "ltr/min": "L/min",
    "bar abs": "bar", "bara": "bar", "psia": "psi", "µs": "us", "μs": "us",
}  # fmt: skip
LONGEST = 300  # characters of a heading in which a unit is looked for
_BRACKETED = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()]*(?:\([^()]*\))?)\)|\{(?P<c>[^{}]*)\})$")
_WORDED = re.compile(r"^(?P<name>.+?)\s+(?:in|/)\s+(?P<unit>\S+)$|^(?P<name2>[^/,]+?),\s+(?P<unit2>\S+)$")


def plain(name: str) -> str:
    """A name without capitals, spaces and signs."""
    return re.sub(r"[\W_]+", "", unicodedata.normalize("NFKC", name).casefold())


_CHANNELS = {plain(name): name for name in MEASURED_UNITS}
_ALIASED = {plain(alias): name for name, aliases in ALIASES.items() for alias in aliases}


def spelled(unit: str) -> str:
    """A unit as `units` reads it, from the spellings that files have."""
    unit = unicodedata.normalize("NFC", unit).strip().strip("[](){}").strip()
    return _SPELLED.get(unit.casefold(), unit)


def heading_of(text: str) -> Heading:
    """The heading of a cell: `current [mA]`, `current (mA)`, `current / mA`, `current in mA`, `current, mA`, or a unit
    after the last underscore where the name before it is a channel's (`current_mA`)."""
    text = text.strip().lstrip("#%").strip().strip('"').strip()
    if len(text) > LONGEST:
        return Heading(text)
    if (found := _BRACKETED.match(text)) is not None:
        unit = next(unit for unit in (found["a"], found["b"], found["c"]) if unit is not None)
        return Heading(found["name"].strip(), spelled(unit))
    if (found := _WORDED.match(text)) is not None and channel_of(name := (found["name"] or found["name2"])):
        return Heading(name.strip(), spelled(found["unit"] or found["unit2"]))
    name, joined, unit = text.rpartition("_")
    if joined and plain(text) not in _CHANNELS and (channel := channel_of(name)) and fits(spelled(unit), channel):
        return Heading(name, spelled(unit))
    return Heading(text)


def channel_of(name: str) -> str | None:
    """The channel that a name stands for, None where it is no channel's."""
    key = plain(name[:LONGEST])
    if name.strip() == "T":  # a temperature, whichever; `t` is the time
        return None
    return _CHANNELS.get(key) or _ALIASED.get(key)


def is_own_name(name: str, channel: str) -> bool:
    """Whether a name is the channel's own, and no alias."""
    return _CHANNELS.get(plain(name[:LONGEST])) == channel


def fits(unit: str, channel: str) -> bool:
    """Whether a unit is of a channel's dimension."""
    try:
        convert(1.0, unit, MEASURED_UNITS[channel])
    except InputError:
        return False
    return True


def is_unit(text: str) -> bool:
    """Whether a cell may stand in a row of units: in brackets, empty, or a unit of any channel."""
    text = text.strip()
    if text in ("", "-", "1", "%") or (text[:1] in "[({" and text[-1:] in "])}"):
        return True
    return any(fits(spelled(text), name) for name in ("time", "current", "voltage", "supply_pressure", "load_flow",
                                                      "spool_position", "oil_temperature", "armature_angle",
                                                      "feedback_force"))  # fmt: skip
