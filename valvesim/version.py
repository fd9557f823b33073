"""The version of this package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """The version of valvesim that is installed; "unknown" where it runs from a folder that never was."""
    try:
        return version("valvesim")
    except PackageNotFoundError:
        return "unknown"
