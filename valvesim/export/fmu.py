"""A scenario's valve as an FMU (FMI 2.0 or 3.0): model exchange and co-simulation in one archive, with its C sources.

The archive holds `modelDescription.xml`, the sources with a CMake file, a binary for this machine where there is a C
compiler, a page on its variables, and an icon. The same valve makes the same archive, byte for byte, with the same
compiler.
"""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from valvesim.errors import InputError, SolveError
from valvesim.export.c_model import model_hash, model_sources
from valvesim.export.fmi_variables import fmi_variables, model_identifier
from valvesim.export.model_description import (
    ModelHead,
    build_description,
    fmi2_description,
    fmi3_description,
    terminals,
)
from valvesim.export.traced_valve import TracedValve, trace_valve
from valvesim.export.variable_page import variable_page
from valvesim.io import write_atomically
from valvesim.simulation.scenario import Scenario
from valvesim.temporary_files import temporary_folder
from valvesim.version import package_version

C_FOLDER = Path(__file__).parent / "c"
MODEL_FILES = ("valve.c", "valve_solver.c", "valve_thermal.c", "valve_rest.c", "valve_text.c")
VERSIONS = ("3.0", "2.0")
CHECKED = ("-Werror=implicit-function-declaration",)  # a call of nothing would fail in the importer alone
COMPILER_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-DNDEBUG", *CHECKED)
PLATFORMS = {  # (system, machine) -> folder of FMI 2.0, of FMI 3.0
    ("Linux", "x86_64"): ("linux64", "x86_64-linux"),
    ("Linux", "aarch64"): ("", "aarch64-linux"),
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin"),
    ("Darwin", "arm64"): ("", "aarch64-darwin"),
}
STAMP = (2000, 1, 1, 0, 0, 0)  # of every file in the archive, so that equal models make equal archives


@dataclass(frozen=True)
class ExportedFmu:
    """What was written: where, with which hash, and the binary inside (None: sources alone, for want of `compiler`)."""

    path: Path
    version: str
    token: str
    binary: str | None
    parameters: int
    inputs: int
    states: int
    outputs: int


def export_fmu(
    scenario: Scenario, path: str | Path, *, version: str = "3.0", compiler: str | None = None
) -> ExportedFmu:  # fmt: skip
    """Write the valve of a scenario as an FMU.

    `compiler` is the C compiler [CC, cc, gcc or clang, where there is one]; "" for sources alone.

    Raises InputError for an unknown version, a batch, an effect that cannot be exported, or a path that cannot be
    written, and SolveError where the compiler fails.
    """
    if version not in VERSIONS:
        raise InputError(f"FMI {version!r} is not written; valid versions: {', '.join(VERSIONS)}", key="fmi")
    valve = trace_valve(scenario)
    head, token = _head(valve), model_hash(valve)
    files = {f"sources/{name}": text for name, text in fmu_sources(valve, version).items()}
    names = [name.partition("/")[2] for name in files if name.endswith(".c")]
    folders = PLATFORMS.get((platform.system(), platform.machine()), ("", ""))
    folder, inside = folders[VERSIONS.index(version) - 1], None
    chosen = None if compiler == "" else find_compiler(compiler)
    if chosen is not None and folder:
        suffix = ".dylib" if platform.system() == "Darwin" else ".so"
        inside = f"binaries/{folder}/{head.identifier}{suffix}"
        files[inside] = _binary(chosen, files, names)
    variables = fmi_variables(valve)
    files["modelDescription.xml"] = (
        fmi2_description(head, variables, names) if version == "2.0" else fmi3_description(head, variables)
    )
    files["documentation/index.html"] = variable_page(head, variables).encode()
    icon = (C_FOLDER / "icon.png").read_bytes()
    if version == "2.0":
        files["model.png"] = icon
    else:
        files["sources/buildDescription.xml"] = build_description(head, names)
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(variables, scenario.drive.command_name)
        for name in ("icon.png", "icon.svg", "terminal.png", "terminal.svg"):
            files[f"terminalsAndIcons/{name}"] = (C_FOLDER / name).read_bytes()
    written = write_atomically(Path(path), lambda temporary: _pack(Path(temporary), files))
    return ExportedFmu(
        path=written, version=version, token=token, binary=inside, parameters=len(valve.parameters),
        inputs=sum(one.causality == "input" for one in variables), states=len(valve.states),
        outputs=len(valve.outputs),
    )  # fmt: skip


def check_replaceable(path: Path, *, overwrite: bool) -> None:
    """InputError where a file stands that is no FMU of this program, unless it may be written over."""
    if overwrite or not path.exists():
        return
    with contextlib.suppress(OSError, KeyError, zipfile.BadZipFile, NotImplementedError, RuntimeError):
        with zipfile.ZipFile(path) as archive, archive.open("modelDescription.xml") as text:
            if b'generationTool="valvesim ' in text.read(5000):
                return
    raise InputError("stands there and is no FMU of valvesim; name another file, or give --overwrite", file=path)


def fmu_sources(valve: TracedValve, version: str) -> dict[str, bytes]:
    """{file name: text} of all that an FMU of this version is compiled from."""
    number, identifier = version[0], model_identifier(valve.scenario.title)
    plain = (*MODEL_FILES, "valve.h", "fmi_instance.h", "fmi_instance.c", f"fmi{number}_types.h", f"fmi{number}.c")
    files = {name: (C_FOLDER / name).read_bytes() for name in plain}
    files |= {name: text.encode() for name, text in model_sources(valve).items()}
    cmake = (C_FOLDER / "CMakeLists.fmu.txt").read_text().replace("@IDENTIFIER@", identifier)
    return dict(sorted(files.items())) | {"CMakeLists.txt": cmake.replace("@NUMBER@", number).encode()}


def find_compiler(named: str | None = None) -> str | None:
    """The path of a C compiler, or None: the one `named`, that of the environment's CC, or the first of the usual."""
    if named is not None:
        found = shutil.which(named)
        if found is None:
            raise InputError(f"no program {named!r} is found", key="compiler")
        return found
    candidates = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((found for name in candidates if name and (found := shutil.which(name))), None)


def compile_c(compiler: str, folder: Path, sources: Sequence[str], output: Path) -> None:
    """Compile and link C files of a folder. SolveError with the compiler's first complaint where that fails."""
    command = [compiler, *COMPILER_FLAGS, *sources, "-o", str(output), "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        complaint = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise SolveError(f"the C compiler {compiler} fails: {complaint.strip()}. --compiler names another, none by ''")


def _binary(compiler: str, files: dict[str, bytes], names: Sequence[str]) -> bytes:
    with temporary_folder(Path(tempfile.gettempdir()), "valvesim-fmu-") as folder:
        for path, text in files.items():
            (folder / Path(path).name).write_bytes(text)
        compile_c(compiler, folder, names, folder / "model.binary")
        with contextlib.suppress(OSError):
            subprocess.run(["strip", "--strip-unneeded", "model.binary"], cwd=folder, capture_output=True, check=False)
        return (folder / "model.binary").read_bytes()


def _head(valve: TracedValve) -> ModelHead:
    scenario = valve.scenario
    return ModelHead(
        identifier=model_identifier(scenario.title), name=scenario.title, token=model_hash(valve),
        description=f"{scenario.title}: two-stage electro-hydraulic servo valve over temperature and time, "
        f"oil {scenario.oil.name}; starts at rest under its first inputs",
        version=package_version(), generated_by=f"valvesim {package_version()}", generated_at="2000-01-01T00:00:00Z",
        stop=float(scenario.duration), step=1.0 / float(scenario.output_rate), tolerance=float(scenario.tolerance),
    )  # fmt: skip


def _pack(path: Path, files: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, STAMP)
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, files[name])


