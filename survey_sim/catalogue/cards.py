"""Cards: what is known of a catalogue (source, licence, checksum, columns with their units), one TOML file each.

A card stands beside its data, and names it by a path inside its own folder: a card from elsewhere cannot reach out of it.
"""

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Literal

from pydantic import Field, field_validator, model_validator

from survey_sim.catalogue.mock import MockRecipe
from survey_sim.catalogue.settings import Name, PriorityRule
from survey_sim.errors import InputError, did_you_mean
from survey_sim.settings import Settings, read_toml

Format = Literal["parquet", "fits", "votable", "csv"]
ColumnName = str

_FORMAT_OF_SUFFIX: dict[str, Format] = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".fits": "fits",
    ".fit": "fits",
    ".vot": "votable",
    ".votable": "votable",
    ".xml": "votable",
}


class ColumnMap(Settings):
    """A column of the file, and the unit that its numbers are in (astropy's syntax: deg, udeg, hourangle, mmag, ...)."""

    name: ColumnName = Field(min_length=1, max_length=200)
    unit: str = Field(min_length=1, max_length=40)


class Columns(Settings):
    """Which columns of the file hold what."""

    # One column, or several whose values are joined by "-".
    source_id: ColumnName | tuple[ColumnName, ...] = "source_id"
    ra: ColumnMap = ColumnMap(name="ra_deg", unit="deg")
    dec: ColumnMap = ColumnMap(name="dec_deg", unit="deg")
    # Absent: the catalogue has no magnitude.
    mag: ColumnMap | None = None
    # Columns of priorities (1 to 9) and of programme names (a programme then takes only its own rows), if there are any.
    priority: ColumnName | None = None
    programme: ColumnName | None = None

    @field_validator("source_id", mode="after")
    @classmethod
    def _has_an_id(cls, value: ColumnName | tuple[ColumnName, ...]) -> ColumnName | tuple[ColumnName, ...]:
        if not value:
            raise ValueError("needs at least one column")
        return value

    @property
    def id_names(self) -> tuple[ColumnName, ...]:
        """Columns whose values make the identifier."""
        return (self.source_id,) if isinstance(self.source_id, str) else self.source_id

    @property
    def names(self) -> tuple[ColumnName, ...]:
        """All columns to read, each once."""
        mapped = [self.ra.name, self.dec.name, self.mag and self.mag.name, self.priority, self.programme]
        return tuple(dict.fromkeys([*self.id_names, *(name for name in mapped if name)]))


class CardSettings(Settings):
    """The text of a card."""

    name: Name
    title: str = ""
    source: str = ""
    licence: str = ""
    # Where the rows come from: a file beside the card, or a recipe that makes them.
    file: str | None = None
    recipe: MockRecipe | None = None
    # Absent: by the file's name.
    format: Format | None = None
    # Of the file as it is, compressed if it is; absent: not checked.
    sha256: str | None = Field(None, pattern=r"^[0-9a-f]{64}$")
    columns: Columns = Columns(mag=ColumnMap(name="mag", unit="mag"))
    # A row whose coordinates or identifier cannot be used: stop, or go on without it and list it among the rejected rows.
    on_bad_row: Literal["error", "reject"] = "error"
    # What programmes take unless they are stricter, mag; and their priority unless they say.
    mag_bright: float | None = None
    mag_faint: float | None = None
    priority: PriorityRule | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> "CardSettings":
        if (self.file is None) == (self.recipe is None):
            raise ValueError("a card needs either file or recipe")
        if self.columns.mag is None and (self.mag_bright is not None or self.mag_faint is not None):
            raise ValueError("magnitude limits need columns.mag")
        return self


@dataclass(frozen=True)
class Card:
    """A card and where it stands.

    Attributes
    ----------
    settings
        What it says.
    path
        The card's own file, or the table's when it has no card.
    data
        The table; None when a recipe makes it.
    format
        How the table is stored.
    """

    settings: CardSettings
    path: Path
    data: Path | None
    format: Format

    @property
    def name(self) -> str:
        """Name of the catalogue."""
        return self.settings.name

    @property
    def title(self) -> str:
        """What the catalogue is."""
        return self.settings.title

    @property
    def licence(self) -> str:
        """Terms of use of its data."""
        return self.settings.licence


def load_card(name_or_path: str | Path, folder: Path) -> Card:
    """Card of a name (in `folder`), of a card's path, or of a table without a card.

    A table without a card (`stars.csv`) has columns source_id, ra_deg, dec_deg and mag, in degrees and magnitudes.

    Raises
    ------
    InputError
        Unknown name, missing file, unknown or impossible key, or a data file outside the card's folder.
    """
    text = str(name_or_path)
    path = Path(text)
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", text):
        path = folder / f"{text}.toml"
        if not path.is_file():
            hint = did_you_mean(text, (card.stem for card in folder.glob("*.toml")))
            raise InputError(f"unknown catalogue {text!r}", file=folder, remedy=f"{hint}; or the path of a card or a table")
    if path.suffix != ".toml":
        return _card_of_table(path)
    settings = CardSettings.load(read_toml(path), file=path)
    if settings.file is None:
        return Card(settings, path, None, "parquet")
    return Card(settings, path, _data_path(settings.file, path), settings.format or _format(Path(settings.file), path))


def list_cards(folder: Path) -> list[Card]:
    """Cards of a folder, by name."""
    return [load_card(path, folder) for path in sorted(folder.glob("*.toml"))]


def _card_of_table(path: Path) -> Card:
    """Card of a table that has none: our own column names and units."""
    if not path.is_file():
        raise InputError("no such file", file=path, remedy="check the path, or name a card of the catalogues folder")
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", path.name.split(".")[0]).strip("-_") or "table"
    return Card(CardSettings.load({"name": name[:64], "file": path.name}), path, path, _format(path, path))


def _data_path(file: str, card: Path) -> Path:
    """Path of a card's data, which must lie inside the card's folder whatever links it goes through."""
    folder = card.parent.resolve()
    outward = PurePosixPath(file).is_absolute() or PureWindowsPath(file).is_absolute() or ".." in re.split(r"[/\\]", file)
    path = folder / file
    if outward or "\0" in file or not path.resolve().is_relative_to(folder):
        remedy = "keep the card in the folder of its data, and give the card's path to the programme"
        raise InputError("the file must lie inside the card's folder", file=card, place="file", remedy=remedy)
    if not path.is_file():
        raise InputError(f"no such file: {file}", file=card, place="file", remedy=f"put it into {card.parent}")
    return path


def _format(data: Path, card: Path) -> Format:
    """Format by the file's name, a trailing .gz aside."""
    suffixes = [suffix.lower() for suffix in data.suffixes]
    suffix = suffixes[-2] if len(suffixes) > 1 and suffixes[-1] == ".gz" else (suffixes or [""])[-1]
    if suffix not in _FORMAT_OF_SUFFIX:
        known = ", ".join(sorted(_FORMAT_OF_SUFFIX))
        raise InputError(f"unknown kind of file {suffix!r}", file=card, place="format", remedy=f"known: {known}")
    return _FORMAT_OF_SUFFIX[suffix]
