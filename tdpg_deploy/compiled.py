"""Numba's compiler as one typed decorator: machine code, cached on disk, IEEE arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """No fastmath: nan must stay nan. Division by zero gives inf, as in NumPy. Other threads of
    the interpreter go on meanwhile."""
    compile_it = numba.njit(cache=True, error_model="numpy", nogil=True)
    return cast("Callable[P, R]", compile_it(function))
