"""Marks for parameters that run the same lines: a few of them quick, the others slow."""

from collections.abc import Iterable
from typing import Any

import pytest


def slow_but(quick: Iterable[Any], cases: Iterable[Any]) -> list:
    """All `cases` for `pytest.mark.parametrize`, those that are none of `quick` marked slow."""
    quick, cases = list(quick), list(cases)
    unknown = [one for one in quick if one not in cases]
    if unknown:
        raise ValueError(f"no such cases: {unknown}")
    return [one if one in quick else _slow(one) for one in cases]


def _slow(case: Any) -> Any:
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
