"""Mutated inputs of every reader of valvesim, from one seed: scenarios, sessions, valve files, specifications, studies,
oils, columns, records of every format, effects files.

A case is a folder with files as a user has them and one to three faults in one of them: a line that is lost, doubled or
another's, a figure of another size, unit, sign or type, a letter exchanged, bytes flipped, the end cut off.
"""

from __future__ import annotations

import functools
import io
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

SEEDS = [
    '[command.current]\nsine = { amplitude = "2 mA", frequency = "50 Hz", offset = "1 mA" }\n',
    '[command.current]\nstep = { before = "-1 mA", after = "5 mA", time = "5 ms" }\n[thermal]\nisothermal = true\n',
    '[command.current]\npulse = { base = "1 mA", height = "2 mA", width = "1 ms", time = "2 ms", period = "5 ms" }\n'
    '[thermal.oil_temperature]\nramp = { start_value = "20 degC", end_value = "100 degC", rate = "3 degC/s" }\n',
    '[command.voltage]\nconstant = "2 V"\n[pressures]\nsupply = "210 bar"\nreturn = "5 bar"\n'
    'load = { sine = { amplitude = "20 bar", frequency = "30 Hz" } }\n',
    '[command.current]\nchirp = { amplitude = "1 mA", start_frequency = "1 Hz", end_frequency = "200 Hz", '
    'duration = "20 ms", logarithmic = true }\n[thermal]\nroutes = ["flow", "mmf"]\nthrottling_heat = true\n'
    'initial_temperature = { body = "60 degC", spool = "20 degC" }\n',
    '[command.current.table]\ntimes = "0, 5, 10 ms"\nvalues = "0, 2, -1 mA"\n[valve]\nnull_gap = "0.03 mm"\n'
    'spool_mass = "5 g"\n[oil]\nname = "yh12_paper"\ndensity_at_20 = "850 kg/m^3"\n',
    '[command.current]\nstaircase = { end_value = "5 mA", steps = 4, hold = "4 ms" }\n[[effects.sensor_bias]]\n'
    'channel = "spool_position"\nbias = "5 um"\n[effects.coil_turns_loss]\nloss = "5 %"\n'
    '[effects.spool_coulomb_friction]\nfriction_force = "1 N"\n',
    '[command.current]\nconstant = "1 mA"\nsine = { amplitude = "1 mA", frequency = "20 Hz" }\n'
    '[thermal.oil_temperature]\nconstant = "40 degC"\npulse = { height = "30 K", width = "3 ms", time = "5 ms" }\n'
    '[outputs]\nrate = "5 kHz"\nchannels = ["spool_position"]\n[solver]\ntolerance = 1e-4\n',
]
WORDS = [
    "",
    "0",
    "-1",
    "1e999",
    "nan",
    "inf",
    "-inf bar",
    "1e308 bar",
    "1e-320 s",
    "20 C",
    "0,03 mm",
    "3000 psig",
    "80 K",
    "-300 degC",
    "1e9 degC",
    "1e300 mA",
    "1 A",
    "-5 V",
    "1e-9 s",
    "1e5 s",
    "1e5 Hz",
    "1e7 Hz",
    "210 bar",
    "\x1b[31mred",
    "\u202eabc",
    "9" * 5000 + " m",
    "é",
    "1 m**9**9",
    " " * 4000 + "x",
    "a" * 4000,
    "1 " + "(" * 500,
    "\x7f",
    "🔧",
    "/dev/zero",
    ".",
    "../..",
    "nowhere.csv",
    "1e-300 kg",
    "1e300 Hz",
    "5 um",
    "1 %",
]
BARE = [
    "true",
    "false",
    "0",
    "-1",
    "1e400",
    "nan",
    "inf",
    "1979-05-27",
    "[]",
    "{}",
    "[1, 2]",
    "[[[[[[1]]]]]]",
    '"""x\ny"""',
    "9" * 5000,
    "0x" + "f" * 5000,
    "[" * 900 + "]" * 900,
    "{ a = 1 }",
    "1979-05-27T07:32:00Z",
    "'x'",
]
LINES = [
    "[valve]",
    "[effects]",
    "[[valve]]",
    "[comand.current]",
    'duraton = "1 s"',
    "x" * 40_000 + ' = "1"',
    "a." * 3000 + "a = 1",
    '[effects.entrained_air]\nair_fraction = "2 %"',
    '[[effects.sensor_bias]]\nchannel = "load_flow"\nbias = "1 L/min"',
    '[effects.thermal_lag]\ntime_constant = "1 s"',
    'title = "\\u001b[31m"',
    'effects_files = ["/dev/zero"]',
    "\x00",
    "= 1",
    "[",
    "[command]",
    '[pressures]\nsupply = { sine = { amplitude = "300 bar", offset = "210 bar" } }',
    '[command.current]\ntable = { file = "/dev/zero" }',
    '[thermal.initial_temperature]\noil = "20 degC"',
]


def mutated_toml(text: str, rng: random.Random) -> str:
    """A TOML text with one to three faults or changes."""
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3])):
        lines = text.split("\n")
        k = rng.randrange(len(lines))
        match rng.randrange(9):
            case 0:
                del lines[k]
            case 1:
                lines.insert(k, rng.choice(LINES))
            case 2:
                lines.insert(k, lines[rng.randrange(len(lines))])
            case 3:  # a quoted figure becomes another
                parts = lines[k].split('"')
                if len(parts) > 2:
                    parts[rng.randrange(1, len(parts), 2)] = (
                        rng.choice(WORDS).replace("\x1b", "\\u001b").replace("\x7f", "\\u007f")
                    )
                lines[k] = '"'.join(parts)
            case 4:  # a value becomes one of another type
                key, equals, _ = lines[k].partition("=")
                lines[k] = f"{key}= {rng.choice(BARE)}" if equals else lines[k]
            case 5:  # a number is scaled
                parts = lines[k].split('"')
                if len(parts) > 2:
                    at = rng.randrange(1, len(parts), 2)
                    number, _, unit = parts[at].partition(" ")
                    try:
                        parts[at] = f"{float(number) * rng.choice([-1, 0, 1e-6, 1e-3, 10, 1e3, 1e6, 1e12]):g} {unit}"
                    except ValueError:
                        pass
                lines[k] = '"'.join(parts)
            case 6:  # a letter is lost, doubled or exchanged
                if lines[k]:
                    at = rng.randrange(len(lines[k]))
                    lines[k] = (
                        lines[k][:at]
                        + rng.choice(["", lines[k][at] * 2, chr(rng.randrange(32, 700))])
                        + lines[k][at + 1 :]
                    )
            case 7:
                lines = [*lines[:k], *lines[k:][: rng.randint(0, 3)]]
            case 8:
                lines[k] = lines[k].replace("=", rng.choice(["==", ":", " = = ", "= \n"]), 1)
        text = "\n".join(lines)
    return text


def mutated_columns(text: str, rng: random.Random) -> str:
    """A text of columns with one to three faults or changes."""
    for _ in range(rng.choice([1, 1, 2, 3])):
        lines = text.split("\n")
        k = rng.randrange(len(lines))
        cells = lines[k].split(",")
        c = rng.randrange(len(cells))
        match rng.randrange(11):
            case 0:
                del lines[k]
            case 1:
                lines.insert(k, lines[rng.randrange(len(lines))])
            case 2:
                cells[c] = rng.choice(CELLS)
                lines[k] = ",".join(cells)
            case 3:
                lines[0] = rng.choice(HEADERS)
            case 4:
                lines[k] = lines[k] + rng.choice([",", ",1", ";", '"', "\0", "\x1b[2J", "\r"])
            case 5:
                lines = [line.replace(",", rng.choice([";", "\t", " ", ", ", "|"])) for line in lines]
            case 6:
                lines = lines[: rng.randrange(len(lines))]
            case 7:  # a figure of another size
                cells[c] = rng.choice(["1e308", "-1e308", "1e-320", "0", "-0", "9" * 4000, "1e999", "NaN", "inf"])
                lines[k] = ",".join(cells)
            case 8:
                lines = [lines[0], *rng.sample(lines[1:], len(lines) - 1)]
            case 9:
                lines = [lines[0]] + [",".join(cells[:1] + line.split(",")[1:]) for line in lines[1:]]
            case 10:
                lines[k] = "".join(chr(rng.randrange(1, 0x300)) for _ in range(rng.randrange(200)))
        text = "\n".join(lines) or "x"
    return text


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes with some flipped, overwritten, cut out, doubled, or the end cut off."""
    out = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        if not out:
            break
        at = rng.randrange(len(out) if rng.random() < 0.5 else min(len(out), 600))
        match rng.randrange(6):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                out[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7, rng.randbytes(8)])
            case 2:
                del out[at : at + rng.choice([1, 8, 100])]
            case 3:
                out[at:at] = out[at : at + rng.choice([1, 8, 100])]
            case 4:
                del out[at:]
            case 5:
                out[at : at + 4] = rng.randrange(2**32).to_bytes(4, "little")
    return bytes(out)


CELLS = ["", " ", "x", "1,5", "1.2.3", "--1", "1e", "0x10", "1_000", "nan", "-nan", "inf", "\x1b[31m", '"', '"1"', "é",
         "=1+1", "\0", "TRUE", "2026-11-24", "12:00:01", "٣", "1" * 5000]  # fmt: skip
HEADERS = [
    "time [s],current [mA]", "time,current,spool_position", "time [s],time [s],current [mA]", "", "a,b,c",
    "[s],[mA],[mm]",
    "time [s],current [bar],spool_position [mm]", "time [s],current [mA],spol_position [mm]",
    "t [s],current [" + "m" * 5000 + "],x [mm]", "\x1b[31mtime [s],current [mA],spool_position [mm]",
    'time [s],"current [mA]\n",spool_position [mm]', "time [ms],current [A],spool_position [m]",
]  # fmt: skip

SESSION = """\
seed = 3
title = "bench"
[[records]]
file = "a.csv"
[[records]]
file = "b.csv"
role = "test"
[tolerances]
null_gap = "10 %"
[sensors.spool_position]
noise = "1 um"
resolution = "0.1 um"
lag = "1 ms"
range = ["-1 mm", "1 mm"]
[thermal]
isothermal = true
[[effects.sensor_bias]]
channel = "spool_position"
bias = "2 um"
"""
SPECIFICATION = """\
title = "38 L/min"
[conditions]
supply_pressure = "210 bar"
oil_temperature = "40 degC"
[figures]
rated_current = "40 mA"
coil_resistance = { value = "80 ohm", tolerance = "10 %" }
rated_flow = { value = "38 L/min", tolerance = "10 %", pressure_drop = "70 bar" }
hysteresis = "2 %"
tare_leakage = { high = "0.9 L/min" }
null_bias = { high = "2 %" }
frequency_minus_90_deg = { value = "110 Hz", amplitude = "40 %" }
"""
VALVE = """\
title = "Servo valve"
serial_number = "7"
[valve]
null_gap = { value = "0.035 mm", tolerance = "10 %", source = "drawing" }
spool_mass = "5 g"
supply_pressure = "210 bar"
[oil]
name = "mil_prf_83282"
[effects.spool_coulomb_friction]
friction_force = "1 N"
"""
OIL = """\
[oil]
name = "my oil"
temperature = "-40, 40, 100 degC"
viscosity = "400, 12.5, 4.75 mm^2/s"
like = "mil_prf_83282"
density_at_20 = "850 kg/m^3"
"""
STUDY = """\
title = "Drift"
[scenario]
duration = "20 ms"
[scenario.thermal]
isothermal = true
[scenario.command.current]
step = { after = "5 mA", time = "5 ms" }
[design]
kind = "latin_hypercube"
members = 20
seed = 1
[vary]
tolerances = true
valve.null_gap = { tolerance = "2 %" }
[figures]
keep = ["run.spool_position.end"]
[limits]
"run.spool_position.end" = { low = "0.19 mm", high = "0.21 mm" }
"""
COLUMNS = """\
[columns]
time = { column = "time [s]", unit = "ms" }
current = { column = "current [mA]", unit = "mA", scale = 2.5, offset = -0.1, sign = -1 }
spool_position = "spool_position [mm]"
load_flow = false
[csv]
separator = ","
"""
PLAN = """\
title = "friction or play"
[thermal]
isothermal = true
[sensors.spool_position]
noise = "1 um"
[added_sensors.load_flow]
noise = "0.05 L/min"
cost = 2
[bench]
rate = "500 Hz"
setup = "10 s"
tests = ["slow small triangle about null"]
[[tests]]
name = "sine"
duration = "0.4 s"
command.current = { sine = { amplitude = "4 mA", frequency = "10 Hz" } }
[aim]
causes = ["spool_coulomb_friction", "feedback_ball_backlash", "spool_lap"]
parameters.feedback_rod_stiffness = "2 %"
"""
EFFECT = """\
import valvesim as vs

own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0),),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""
NAMED_OIL = 'duration = "20 ms"\n[oil]\nfile = "oil.toml"\n[command]\ncurrent = "1 mA"\n'
NAMED_TABLE = 'duration = "20 ms"\n[command.current]\ntable = { file = "table.csv" }\n'


@functools.cache
def columns(count: int = 120) -> str:
    """A record as a text of columns."""
    rows = ["time [s],current [mA],spool_position [mm]"]
    for k in range(count):
        rows.append(f"{k / 1e3:.3f},{5 * ((k * 0.06) % 1.0):.4f},{0.2 * ((k * 0.06) % 1.0):.5f}")
    return "\n".join(rows) + "\n"


@functools.cache
def binary_records() -> dict[str, bytes]:
    """A record in each of the formats that are no text, by a file name."""
    import asammdf
    import h5py
    import nptdms
    import numpy as np
    import openpyxl
    import pandas
    import xarray
    from scipy.io import savemat

    time = np.arange(120) / 1e3
    current, spool = 5e-3 * np.sin(60.0 * time), 2e-4 * np.sin(60.0 * time)
    table = {"time [s]": time, "current [A]": current, "spool_position [m]": spool}
    made: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        savemat(place / "5.mat", {"time": time, "current": current, "spool_position": spool,
                                  "units": {"time": "s", "current": "A", "spool_position": "m"}})  # fmt: skip
        with h5py.File(place / "73.mat", "w", userblock_size=512) as file:
            for name, value in {"t_s": time, "current_A": current, "spool_position_m": spool}.items():
                file.create_dataset(name, data=value[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        with open(place / "73.mat", "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
        with nptdms.TdmsWriter(place / "a.tdms") as file:
            file.write_segment(
                [nptdms.ChannelObject("bench", name, value, {"wf_increment": 1e-3, "unit_string": unit})
                 for name, value, unit in (("current", current, "A"), ("spool_position", spool, "m"))]
            )  # fmt: skip
        with asammdf.MDF(version="4.10") as file:
            file.append([asammdf.Signal(current, time, unit="A", name="current"),
                         asammdf.Signal(spool, time, unit="m", name="spool_position")])  # fmt: skip
            file.save(place / "a.mf4")
        pandas.DataFrame(table).to_parquet(place / "a.parquet")
        book = openpyxl.Workbook()
        for row in (list(table), *(list(map(float, row)) for row in zip(*table.values(), strict=True))):
            book.active.append(row)
        book.save(place / "a.xlsx")
        xarray.Dataset(
            {"current": ("time", current, {"units": "A"}), "spool_position": ("time", spool, {"units": "m"})},
            coords={"time": ("time", time, {"units": "s"})},
        ).to_netcdf(place / "a.nc")
        for path in place.iterdir():
            made[path.name] = path.read_bytes()
    return made


@functools.cache
def rezipped(data: bytes) -> tuple[tuple[str, bytes], ...]:
    """The members of a zip file: an xlsx is one, and flipped bytes of the archive itself only break its checksum."""
    import zipfile

    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def mutated_zip(data: bytes, rng: random.Random) -> bytes:
    """A zip file with one of its members mutated."""
    import zipfile

    members = rezipped(data)
    chosen, out = rng.randrange(len(members)), io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for k, (name, content) in enumerate(members):
            archive.writestr(name, mutated_bytes(content, rng) if k == chosen else content)
    return out.getvalue()


def _scenario(rng: random.Random) -> dict[str, str | bytes]:
    return {"case.toml": mutated_toml('title = "fuzz"\nduration = "20 ms"\n' + rng.choice(SEEDS), rng)}


def _session(rng: random.Random) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {"session.toml": SESSION, "a.csv": columns(), "b.csv": columns(100)}
    if rng.random() < 0.5:
        return files | {"session.toml": mutated_toml(SESSION, rng)}
    return files | {"a.csv": mutated_columns(columns(), rng)}


def _one(name: str, text: str, **others: str) -> Callable[[random.Random], dict[str, str | bytes]]:
    return lambda rng: {name: mutated_toml(text, rng), **{k.replace("_", "."): v for k, v in others.items()}}


def _record(rng: random.Random) -> dict[str, str | bytes]:
    if rng.random() < 0.4:
        return {rng.choice(["a.csv", "a.txt", "a.lvm", "a.tsv"]): mutated_columns(columns(), rng)}
    name = rng.choice(sorted(binary_records()))
    data = binary_records()[name]
    if name.endswith(".xlsx") and rng.random() < 0.7:
        return {name: mutated_zip(data, rng)}
    return {name: mutated_bytes(data, rng)}


def _table(rng: random.Random) -> dict[str, str | bytes]:
    text = "\n".join(line.rsplit(",", 1)[0] for line in columns(40).split("\n"))
    return {"case.toml": NAMED_TABLE, "table.csv": mutated_columns(text, rng)}


def _columns(rng: random.Random) -> dict[str, str | bytes]:
    return {"columns.toml": mutated_toml(COLUMNS, rng), "a.csv": columns()}


READERS: dict[str, tuple[float, Callable[[random.Random], dict[str, str | bytes]]]] = {
    "scenario": (3.0, _scenario),
    "session": (2.0, _session),
    "valve": (1.0, _one("valve.toml", VALVE)),
    "specification": (1.0, _one("page.toml", SPECIFICATION)),
    "study": (1.0, _one("study.toml", STUDY)),
    "plan": (0.7, _one("plan.toml", PLAN)),
    "oil": (0.5, _one("oil.toml", OIL, case_toml=NAMED_OIL)),
    "table": (0.5, _table),
    "columns": (0.3, _columns),
    "record": (2.0, _record),
    "effects": (0.3, _one("own.py", EFFECT)),
}
"""Each reader with its share of the cases and what draws one: files by name."""


def draw(rng: random.Random) -> tuple[str, dict[str, str | bytes]]:
    """(reader, files by name) of one case."""
    names = list(READERS)
    reader = rng.choices(names, [READERS[name][0] for name in names])[0]
    return reader, READERS[reader][1](rng)
