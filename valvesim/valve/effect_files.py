"""A user's own effects: Python files that declare them at their top level, run as they are."""

from __future__ import annotations

import traceback
import types
from collections.abc import Sequence
from pathlib import Path

from valvesim.channels import INPUT_CHANNELS, STATE_CHANNELS, Inputs, State
from valvesim.errors import InputError, unknown_name
from valvesim.units import parse
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import CHANNEL, Effect, Ports, Situation
from valvesim.valve.effect_trust import check_trusted, code_of
from valvesim.valve.equations import AT_20
from valvesim.valve.parameters import Valve


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file declares at its top level, in their order. The file is run, as an import would.

    Raises InputError for a file that fails to run (with its line), holds no `Effect`, or has a name of the catalogue,
    and for an effect with a name that files cannot hold, an unknown unit, a balance of another form, or that names a
    `plainer` effect or others that it is `indistinguishable_from` which are neither in the catalogue nor in the file.
    """
    return _run(Path(path), code_of(Path(path)))


def _run(path: Path, content: bytes) -> tuple[Effect, ...]:
    """The effects of a file's content, which is what was trusted, whatever stands in the file by now."""
    module = types.ModuleType(path.stem)
    module.__file__ = str(path)
    try:
        # executed, not imported: an import would leave its bytecode in the user's folder
        exec(compile(content.decode("utf-8-sig"), str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:  # a user's file may raise anything
        raise _failed(path, error) from error
    own = list({id(v): v for v in vars(module).values() if isinstance(v, Effect)}.values())
    own = [effect for effect in own if effect is not CATALOGUE.get(effect.name)]  # what it took from there to build on
    if not own:
        raise InputError("declares no effect; expected `name = valvesim.Effect(...)` at its top level", file=path)
    for k, effect in enumerate(own):
        if effect.name in CATALOGUE:
            raise InputError(f"effect {effect.name!r} is in the catalogue already; give yours another name", file=path)
        if effect.name in (other.name for other in own[:k]):
            raise InputError(f"two effects are called {effect.name!r}", file=path)
        try:
            _ = effect.amplitude
            _check_words(effect)
            _check_relations(effect, own)
            _check_balance(effect)
        except InputError as error:
            raise InputError(str(error), file=path) from None
        except Exception as error:  # its balance may raise anything
            raise _failed(path, error) from error
    return tuple(own)


def _check_words(effect: Effect) -> None:
    """Names and units are written to files and read again."""
    for word in (effect.name, *(p.name for p in effect.parameters)):
        if not (word.isidentifier() and word.isascii()):
            raise InputError(f"effect {effect.name!r}: the name {word!r} may hold letters, digits and _ alone")
    for p in effect.parameters:
        if not p.unit:
            raise InputError(f"effect {effect.name!r}: {p.name} has no unit; one without a dimension has '1'")
        if CHANNEL not in p.unit and p.unit != "1":
            parse(f"1 {p.unit}", p.unit, f"effect {effect.name!r}: {p.name}")


def _check_relations(effect: Effect, own: Sequence[Effect]) -> None:
    """The other effects that one is held against must be of the catalogue or of the same file."""
    known = [*CATALOGUE, *(other.name for other in own if other is not effect)]
    if isinstance(effect.indistinguishable_from, str):  # each of its letters would be a name
        raise InputError(f"effect {effect.name!r}: indistinguishable_from must be a tuple of names of effects")
    plainer = (effect.plainer,) if effect.plainer else ()
    for field, names in (("plainer", plainer), ("indistinguishable_from", effect.indistinguishable_from)):
        for name in names:
            if name not in known:
                raise unknown_name("effect", name, known, f"effect {effect.name!r}: {field}")


def _check_balance(effect: Effect) -> None:
    """The balance, tried once at figures of a usual size, must give ports and a rate for each memory."""
    if effect.balance is None:
        return
    state = State(*(channel.scale for channel in STATE_CHANNELS))
    inputs = Inputs(*(channel.scale for channel in INPUT_CHANNELS))
    situation = Situation(state, inputs, inputs.command, 0.0, 1e-4, 5e-6, 5e-6, Valve().at(AT_20))
    p = effect.values(p.default for p in effect.parameters)
    given = effect.balance(situation, p, tuple(memory.scale for memory in effect.memory))
    ports, rates = given if isinstance(given, tuple) and len(given) == 2 else (given, None)
    if not isinstance(ports, Ports) or not isinstance(rates, tuple) or len(rates) != len(effect.memory):
        raise InputError(
            f"effect {effect.name!r}: its balance must give (vs.Ports(...), rates) with a tuple of "
            f"{len(effect.memory)} rates, got {str(given)[:80]}"
        )


def load_effects_files(
    folder: Path, files: Sequence[str | Path], *, given: Sequence[str | Path] = ()
) -> tuple[Effect, ...]:
    """The effects of files that a file in `folder` names, relative to it or absolute, and of those that a caller gives.

    Raises InputError as `load_effects` does, where two files declare one name, and for a named one that may not be run
    (`effect_trust`).
    """
    effects: dict[str, Effect] = {}
    for file, named in [*((file, True) for file in files), *((file, False) for file in given)]:
        try:
            content = code_of(folder / file)
        except InputError as error:
            raise InputError(str(error), key="effects_files") from None
        if named:
            check_trusted(folder / file, content, folder)
        try:
            own = _run(folder / file, content)
        except InputError as error:
            raise InputError(str(error), key="effects_files") from None
        for effect in own:
            if effect.name in effects:
                problem = f"{str(file)!r} declares {effect.name!r}, which another file did already"
                raise InputError(problem, key="effects_files")
            effects[effect.name] = effect
    return tuple(effects.values())


def _failed(path: Path, error: BaseException) -> InputError:
    """The error for a user's file that failed to run, with the last of its own lines that was reached."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    if isinstance(error, SyntaxError) and error.filename == str(path):
        lines.append(error.lineno)
    line = lines[-1] if lines else None
    return InputError(f"fails with {type(error).__name__}: {error}", file=path, line=line)
