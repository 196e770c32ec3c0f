"""`kernel`, `inner_kernel`, `inlined_kernel`: a compiled function, kept on disk until a file of its folder is edited.

`numba.njit(cache=True)` keeps what it compiles until the file of the function itself changes. A kernel that calls a kernel
of another file has that one compiled into it, and would go on with the old one after an edit there. `kernel` looks at all
files of the folder instead, so that the kernels of a room can stand in several files of one folder, which holds nothing
else: kernels that call each other stand in one folder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile


@cache
def _digest_of_folder(folder: Path) -> bytes:
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


class _FolderCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """numba's cache of one function, stale as soon as any file beside the function's has changed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        folder = Path(function.__code__.co_filename).parent
        self._cache_file = IndexDataCacheFile(self.cache_path, self._impl.filename_base, _digest_of_folder(folder))


def _kept(compiled: Any, function: Callable[..., Any]) -> Any:
    compiled._cache = _FolderCache(function)
    return compiled


def kernel(function: Callable[..., Any]) -> Any:
    """
    Compile a function at its first call, without the interpreter and without reordering of floating point operations.

    Parameters
    ----------
    function : callable
        Of numbers and C-contiguous arrays; it may call other kernels of its own folder.

    Returns
    -------
    numba dispatcher
        What is compiled is kept on disk where `numba.njit(cache=True)` keeps it.
    """
    return _kept(njit(function), function)


def inner_kernel(function: Callable[..., Any]) -> Any:
    """
    Compile a function that kernels call often, as `kernel` does, but without counts of references to arrays.

    The counts cost two atomic operations for each array of each call, tuples' arrays included: several times what a function
    of a few lines takes. Whoever calls it holds the arrays meanwhile.

    Parameters
    ----------
    function : callable
        As for `kernel`; it makes no array, and calls only functions that make none (numba refuses others).

    Returns
    -------
    numba dispatcher
        What is compiled is kept on disk where `numba.njit(cache=True)` keeps it.
    """
    return _kept(njit(_nrt=False)(function), function)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """
    Compile a function as `inner_kernel` does, into each kernel that calls it.

    A call hands over each array as seven numbers: where a function is called for a few operations on records of many arrays,
    that takes as long as they do. Large functions called from many places make compilation long: they stay `inner_kernel`.

    Parameters
    ----------
    function : callable
        As for `inner_kernel`.

    Returns
    -------
    numba dispatcher
        What is compiled is kept on disk where `numba.njit(cache=True)` keeps it.
    """
    return _kept(njit(_nrt=False, forceinline=True)(function), function)
