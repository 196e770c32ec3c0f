"""Base of every settings model: frozen, and strict about names."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from survey_sim.errors import InputError, did_you_mean


class Settings(BaseModel):
    """Frozen settings; unknown keys, NaN and infinities are errors."""

    # Names of inner fields that the user's file does not spell, left out of the places that errors name.
    unspoken_keys: ClassVar[frozenset[str]] = frozenset()

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def load(cls, values: Mapping[str, Any], *, file: str | Path | None = None, section: str = "") -> Self:
        """Settings from plain values, with errors that name key, rule and remedy.

        Raises
        ------
        InputError
            For an unknown key (with the nearest known one), or a value of the wrong type or range.
        """
        try:
            return cls.model_validate(values)
        except ValidationError as failure:
            raise _input_error(cls, failure, file, section) from None


def read_toml(path: Path) -> dict[str, Any]:
    """Values of a TOML file; InputError if it is missing or malformed."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, IsADirectoryError):
        raise InputError("no such file", file=path, remedy="check the path") from None
    except UnicodeDecodeError as failure:
        raise InputError(f"is not UTF-8 text: {failure.reason}", file=path, remedy="save it as UTF-8") from None
    except tomllib.TOMLDecodeError as failure:
        raise InputError(f"is not TOML: {failure}", file=path, remedy="mend the line named") from None
    except (RecursionError, ValueError) as failure:  # nested without end; numbers that the parser cannot hold
        raise InputError(f"is no sound TOML: {failure}", file=path, remedy="mend its values") from None
    except OSError as failure:
        raise InputError(f"cannot be read: {failure.strerror}", file=path, remedy="check the path and its rights") from None


def _input_error(model: type[Settings], failure: ValidationError, file: str | Path | None, section: str) -> InputError:
    """The first fault of a validation, in our words; the rest are counted."""
    errors = failure.errors()
    first = errors[0]
    keys = [str(part) for part in first["loc"] if part not in model.unspoken_keys]
    place = ".".join([section, *keys] if section else keys)
    more = f" (and {len(errors) - 1} more faults)" if len(errors) > 1 else ""
    if first["type"] == "extra_forbidden":
        owner = _model_at(model, first["loc"][:-1])
        hint = did_you_mean(keys[-1], owner.model_fields) if owner else None
        return InputError(f"unknown key{more}", file=file, place=place, remedy=hint)
    given = "" if first["type"] == "missing" else f", not {first['input']!r}"
    refusal = first.get("ctx", {}).get("error")
    if isinstance(refusal, InputError):
        return InputError(f"{refusal.rule}{more}", file=file, place=place, rows=refusal.rows, remedy=refusal.remedy)
    message = first["msg"].removeprefix("Value error, ")
    hint = None
    if first["type"] == "literal_error" and isinstance(first["input"], str):
        hint = did_you_mean(first["input"], _quoted(first["ctx"]["expected"]))
    return InputError(f"{message[0].lower()}{message[1:]}{given}{more}", file=file, place=place, remedy=hint)


def _model_at(model: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """The settings model that holds the key at `location`, through lists and options."""
    for part in location:
        if isinstance(part, int):
            continue
        if part not in model.model_fields:
            return None
        found = _first_model(model.model_fields[part].annotation)
        if found is None:
            return None
        model = found
    return model


def _first_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _first_model(argument)
        if found is not None:
            return found
    return None


def _quoted(text: str) -> list[str]:
    return text.split("'")[1::2]
