"""Allocators and routers of other packages, found by the entry points that those packages declare.

A pipeline names one as it names ours. Nothing of another package is imported before it is named; our own names win.
"""

from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from survey_sim.errors import InputError, did_you_mean

Kind = Literal["allocator", "router"]


def group(kind: Kind) -> str:
    """Entry-point group of a kind: `survey_sim.allocators` or `survey_sim.routers`."""
    return f"survey_sim.{kind}s"


def installed(kind: Kind) -> dict[str, list[EntryPoint]]:
    """Entry points of a kind in this environment, by name: one, unless packages quarrel about the name."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in sorted(entry_points(group=group(kind)), key=_package):
        found.setdefault(entry.name, []).append(entry)
    return found


def known_names(kind: Kind, built_in: Iterable[str]) -> tuple[str, ...]:
    """Our own names, then those of other packages."""
    ours = tuple(built_in)
    return (*ours, *(name for name in sorted(installed(kind)) if name not in ours))


def check_name(kind: Kind, name: str, built_in: Iterable[str]) -> str:
    """The name, if it is ours or that of one installed package.

    Raises
    ------
    InputError
        It is unknown, or two packages claim it.
    """
    ours = tuple(built_in)
    if name not in ours:
        _find(kind, name, ours)
    return name


def origin(kind: Kind, name: str, built_in: Iterable[str]) -> dict[str, str] | None:
    """Where a name of another package comes from: `package` with its version, and `sha256` of its code; None for ours."""
    ours = tuple(built_in)
    if name in ours:
        return None
    entry = _find(kind, name, ours)
    return {"package": _package(entry), "sha256": _code_digest(entry)}


@cache
def load(kind: Kind, name: str) -> Any:
    """What another package's entry point names; imported once a process.

    Raises
    ------
    InputError
        It is not installed here, or cannot be imported.
    """
    entry = _find(kind, name, ())
    try:
        return entry.load()
    except (ImportError, AttributeError) as failure:
        rule = f"{kind} {name!r} cannot be imported: {failure}"
        raise InputError(rule, place=entry.value, remedy=f"mend or reinstall {_package(entry)}") from failure


def _find(kind: Kind, name: str, built_in: tuple[str, ...]) -> EntryPoint:
    found = installed(kind)
    claims = found.get(name, [])
    if len(claims) == 1:
        return claims[0]
    if claims:
        packages = " and ".join(_package(entry) for entry in claims)
        raise InputError(f"{kind} {name!r} is claimed by {packages}", remedy="uninstall one of them")
    others = ", ".join(f"{other} ({_package(entry[0])})" for other, entry in found.items()) or "none"
    near = did_you_mean(name, known_names(kind, built_in))
    hint = f"{near} " if near.startswith("did") else ""
    remedy = f"{hint}built in: {', '.join(built_in)}; of installed packages: {others}"
    raise InputError(f"unknown {kind} {name!r}", remedy=remedy)


def _code_digest(entry: EntryPoint) -> str:
    """Digest of the top module that the entry point names, or of all of its package: versions do not tell of edits."""
    spec = find_spec(entry.module.split(".")[0])
    file = Path(spec.origin) if spec is not None and spec.origin is not None else None
    if file is None or not file.is_file():
        return ""
    sources = sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]
    digest = sha256()
    for source in sources:
        digest.update(source.relative_to(file.parent).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unnamed package"
