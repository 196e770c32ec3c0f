"""The docs page of all settings, from the models that check them and the comments that stand there."""

from __future__ import annotations

import inspect
import io
import re
import tokenize
from collections.abc import Iterator
from textwrap import dedent
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from survey_sim.instrument import Instrument
from survey_sim.settings import Settings
from survey_sim.survey.settings import PipelineSettings

_HEAD = """# Settings

<!-- Written by `make docs` from the settings models: do not edit. -->

Every key of a pipeline's TOML file, with its default; `survey-sim run PIPELINE.toml --set section.key=value` changes one
for a run. Unknown keys, wrong types and values out of range are errors that name the key. Sources: P = Goodwin et al. 2014,
SPIE 9152; T = the TAIPAN survey's public tiling code; D = derived from these; assumed = no source gives a value.
"""
_WORDS = {"float": "number", "int": "whole number", "str": "text", "bool": "true or false", "Any": "any value"}
_SIGNS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}


def settings_page() -> str:
    """The page, as Markdown."""
    return _HEAD + "".join(_model(name, field.annotation) for name, field in PipelineSettings.model_fields.items())


def _model(section: str, annotation: Any, note: str = "") -> str:
    """The section of the settings model in a field's annotation, and those of the models inside it."""
    model = next(_models(annotation))
    key = f"[[{section}]]" if get_origin(annotation) is tuple else f"[{section}]"
    lines = [f"\n## `{key}`{note}\n", f"{_sentence(model)}\n"]
    comments, inner, rows = field_comments(model), [], []
    for name, field in model.model_fields.items():
        nested = list(_models(field.annotation))
        if name in PipelineSettings.unspoken_keys:
            return _model(section, field.annotation)
        if name == "overrides":
            inner.append(_model(section, Instrument, ": constants of the instrument"))
        elif nested and get_origin(field.annotation) not in {tuple, UnionType, Union}:
            is_by_name = get_origin(field.annotation) is dict
            inner.append(_model(f"{section}.{name}.NAME" if is_by_name else f"{section}.{name}", field.annotation))
        else:
            rows.append(f"| `{name}` | {_type(field)} | {_default(field)} | {comments.get(name, '')} |")
    if rows:
        lines += ["| key | value | default | meaning |", "|---|---|---|---|", *rows]
    return "\n".join(lines) + "\n" + "".join(inner)


def field_comments(model: type[Settings]) -> dict[str, str]:
    """What the comments above and beside each field of a model say."""
    comments: dict[str, str] = {}
    above: list[str] = []
    for line in dedent(inspect.getsource(model)).splitlines():
        named = re.match(r"\s+(\w+): ", line)
        if line.strip().startswith("#"):
            above.append(line.strip().lstrip("# "))
        elif named and named[1] in model.model_fields:
            comments[named[1]] = _escaped(" ".join([*above, *_trailing(line)]))
            above = []
        else:
            above = []
    return comments


def _trailing(line: str) -> list[str]:
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(line.strip()).readline))
    except tokenize.TokenError:
        return []
    return [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]


def _models(annotation: Any) -> Iterator[type[Settings]]:
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)


def _type(field: FieldInfo) -> str:
    limits = ", ".join(_limits(field.metadata))
    return _words(field.annotation) + (f", {limits}" if limits else "")


def _words(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is None:
        return _plain_words(annotation)
    if origin is Annotated:
        limits = ", ".join(_limits([bound for extra in arguments[1:] for bound in getattr(extra, "metadata", [extra])]))
        return _words(arguments[0]) + (f" {limits}" if limits else "")
    if origin is Literal:
        return ", ".join(f"`{value!r}`".replace("'", '"') for value in arguments)
    if origin is tuple:
        inner = [_words(argument) for argument in arguments if argument is not ...]
        return f"list of {inner[0]}" if ... in arguments else f"[{', '.join(inner)}]"
    if origin is dict:
        return f"table: NAME = {_words(arguments[1])}"
    return " or ".join(_words(argument) for argument in arguments if argument is not NoneType)


def _plain_words(annotation: Any) -> str:
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return "{ " + ", ".join(annotation.model_fields) + " }"
    name = getattr(annotation, "__name__", str(annotation))
    return _WORDS.get(name, name)


def _limits(metadata: list[Any]) -> list[str]:
    return [f"{sign} {getattr(bound, key):g}" for bound in metadata for key, sign in _SIGNS.items() if hasattr(bound, key)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "(must be given)"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ({}, ()):
        return "absent" if value is None else "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    text = _toml(value)
    return f"`{text}`" if len(text) < 60 else f"`{text[:50]}` ..."


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def _sentence(model: type[Settings]) -> str:
    first = inspect.cleandoc(model.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    first = re.sub(r"^`\[[^`]*`: ", "", first)
    return first[:1].upper() + first[1:]


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")
