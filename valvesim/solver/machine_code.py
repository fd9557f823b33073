"""Printed functions as machine code of their own, which compiled loops call by its address.

The loops of the integrator are the same for every model, and numba takes seconds over them: they are compiled once.
What differs from model to model are straight lines (`straight_line`), and LLVM alone makes machine code of these in a
fifth of a second. A printed text begins with its layout, the dictionary that says how its arrays lie.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from valvesim.solver import cache, straight_line

LAYOUT = "LAYOUT = "  # begins the first line of a printed text
OPTIMISATION = 2  # LLVM's level: the third takes a tenth longer and makes nothing faster


@dataclass(frozen=True, eq=False)
class MachineCode:
    """Machine code in memory: the `addresses` of its functions by name, and the layout of the text that was printed.

    The addresses hold as long as this does: see `bound`.
    """

    addresses: dict[str, int]
    layout: dict[str, Any]
    _engine: Any

    def bound(self, loop: Any, names: Iterable[str], *more: Any) -> Callable:
        """A compiled loop with the addresses of some functions as its first arguments, then `more`; it keeps the
        machine code.
        """
        ready: Any = functools.partial(loop, *(self.addresses[name] for name in names), *more)
        ready.machine_code = self
        return ready


def with_layout(
    lines: Sequence[str], *, lanes: int, columns: dict[str, int], shared: Sequence[str], numbers: Sequence[str],
    **facts: Any,
) -> str:  # fmt: skip
    """Printed lines under their layout: that of `straight_line.write_functions`, and `facts` for who calls them."""
    layout = {"lanes": lanes, "columns": columns, "shared": tuple(shared), "numbers": tuple(numbers), **facts}
    return "\n".join([f"{LAYOUT}{layout!r}", *lines])


def printed_layout(printed: str) -> dict[str, Any]:
    """The layout at the top of a printed text."""
    return ast.literal_eval(printed.partition("\n")[0].removeprefix(LAYOUT))


def load_machine_code(short_name: Sequence[str] | None, printed: Callable[[], str]) -> MachineCode:
    """The machine code of a printed text, kept or new; see `cache.load`."""
    whole, code = cache.load_object(short_name, printed, (straight_line.write_functions, load_object_code), object_code)
    return load_object_code(whole, code)


def load_object_code(printed: str, code: bytes) -> MachineCode:
    """The functions of an object file that `object_code` has made of a printed text."""
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _processor())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    names = straight_line.function_names(printed)
    addresses = {name: engine.get_function_address(straight_line.SYMBOL + name) for name in names}
    return MachineCode(addresses, printed_layout(printed), engine)


def object_code(printed: str) -> bytes:
    """The machine code of a printed text, as the bytes of an object file for the processor at hand."""
    import llvmlite.binding as llvm
    from llvmlite import ir

    layout = printed_layout(printed)
    module = ir.Module("valvesim")
    straight_line.write_functions(printed, module, **{k: layout[k] for k in ("lanes", "columns", "shared", "numbers")})
    machine, reference = _processor(), llvm.parse_assembly(str(module))
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=OPTIMISATION))
    builder.getModulePassManager().run(reference, builder)
    return machine.emit_object(reference)


def _processor() -> Any:
    """The processor at hand as a target of LLVM, new, for an engine takes possession of it."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features, opt=OPTIMISATION, codemodel="jitdefault", jit=True
    )


def loops_source(functions: Sequence[str], names: str = "", options: str = "error_model='numpy'") -> str:
    """The Python source of a module of loops that call printed functions: numba's, with more `options`. `names` is the
    line that imports what else they need.
    """
    return "\n".join(
        [
            "import numpy as np",
            "from numba import njit",
            "from valvesim.solver.machine_code import caller",
            names,
            "call = caller()",
            *(f"@njit(nogil=True, {options})\n{function}" for function in functions),
        ]
    )


@functools.cache
def caller() -> Any:
    """`call(address, *arguments)` for compiled code: calls a printed function with contiguous arrays and numbers."""
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.core.errors import TypingError
    from numba.extending import intrinsic

    def passed(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            return context.make_array(kind)(context, builder, value).data
        return context.cast(builder, value, kind, types.float64)

    @intrinsic
    def call(context, address, *arguments):
        if any(isinstance(kind, types.Array) and kind.layout != "C" for kind in arguments):
            raise TypingError("printed functions take contiguous arrays")

        def generate(context, builder, signature, values):
            given = zip(arguments, cgutils.unpack_tuple(builder, values[1], len(arguments)), strict=True)
            pointers_and_numbers = [passed(context, builder, *one) for one in given]
            kind = ir.FunctionType(ir.VoidType(), [value.type for value in pointers_and_numbers])
            builder.call(builder.inttoptr(values[0], kind.as_pointer()), pointers_and_numbers)
            return context.get_dummy_value()

        return types.void(address, types.BaseTuple.from_types(arguments)), generate

    return call
