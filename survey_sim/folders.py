"""Where the data folders are: beside the package in a checkout, inside it once installed from a wheel."""

import os
from pathlib import Path

from survey_sim.errors import InputError, did_you_mean

PACKAGE = Path(__file__).resolve().parent


def data_folder(name: str) -> Path:
    """Folder `catalogues`, `pipelines` or `reports`."""
    installed = PACKAGE / "data" / name
    return installed if installed.is_dir() else PACKAGE.parent / name


def find_pipeline(name: str | Path) -> Path:
    """The pipeline file at a path, or of that name among those that come with the package ("demo").

    Raises
    ------
    InputError
        There is neither.
    """
    path = Path(name)
    if path.is_file():
        return path
    shipped = {file.stem: file for file in sorted(data_folder("pipelines").rglob("*.toml"))}
    stem = path.stem if path.suffix == ".toml" else path.name
    if path.parent.name in {"", "pipelines", "scenarios"} and stem in shipped:
        return shipped[stem]
    raise InputError("no such file", file=path, remedy=did_you_mean(stem, shipped))


def cache_folder() -> Path:
    """Folder of made catalogues, shared by all runs of this user; the variable SURVEY_SIM_CACHE names another."""
    if named := os.environ.get("SURVEY_SIM_CACHE"):
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "survey-sim"
