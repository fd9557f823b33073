"""What the figures of a member depend on besides its study: the text of this package and the libraries that compute."""

from __future__ import annotations

import functools
import hashlib
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "numba", "casadi")
_DRAW_NOTHING = ("cli", "reports")  # packages that no figure depends on


@functools.cache
def versions() -> dict[str, str]:
    """Versions by name, and "code", a hash of the package's modules: two processes with equal ones compute the same."""
    package = Path(__file__).parents[1]
    modules = sorted(path for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in _DRAW_NOTHING)
    text = b"\0".join(path.relative_to(package).as_posix().encode() + path.read_bytes() for path in modules)
    return {
        "valvesim": _version("valvesim"),
        "code": hashlib.sha256(text).hexdigest()[:16],
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        **{name: _version(name) for name in LIBRARIES},
    }


def difference(own: dict[str, str], other: dict[str, str]) -> str:
    """Where other versions differ, in words; empty where they are the same."""
    names = [name for name in own if other.get(name) != own[name]]
    return ", ".join(f"{name} {other.get(name, 'missing')} instead of {own[name]}" for name in names)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
