"""What the command line asks of catalogues, as plain data to print."""

from pathlib import Path
from typing import Any

from survey_sim.catalogue.cards import load_card
from survey_sim.catalogue.mock import cached_mock, make_mock
from survey_sim.catalogue.reading import read_catalogue
from survey_sim.errors import InputError
from survey_sim.folders import cache_folder


def check_catalogue(name_or_path: str | Path, folder: Path, cache_dir: Path | None = None) -> dict[str, Any]:
    """Read a catalogue whole and say what it holds.

    Raises
    ------
    InputError
        As `load_card` and `read_catalogue`.
    """
    card = load_card(name_or_path, folder)
    catalogue = read_catalogue(card, cache_dir or cache_folder())
    rows = catalogue.rows
    found: dict[str, Any] = {
        "catalogue": card.name,
        "title": card.title or "-",
        "source": card.settings.source or "-",
        "licence": card.licence or "-",
        "file": str(catalogue.path),
        "sha256": catalogue.sha256,
        "usable rows": rows.height,
    }
    for name in ("ra_deg", "dec_deg", "mag"):
        values = rows[name].drop_nulls().to_numpy()
        found[name] = f"{values.min():.4f} to {values.max():.4f}" if len(values) else "-"
    reasons = catalogue.rejected.group_by("reason").len().sort("reason")
    return found | {f"rejected, {row['reason']}": row["len"] for row in reasons.iter_rows(named=True)}


def make_catalogue(name_or_path: str | Path, folder: Path, seed: int | None, out: Path | None) -> dict[str, Any]:
    """Make the mock of a card: into the cache, where runs look for it, or into a file.

    Parameters
    ----------
    seed
        Instead of the card's own, which is the one that runs use.

    Raises
    ------
    InputError
        The card has no recipe, or the file cannot be written.
    """
    card = load_card(name_or_path, folder)
    if card.settings.recipe is None:
        remedy = "only cards with a recipe can be made, such as taipan-mock"
        raise InputError(f"catalogue {card.name} has no recipe", file=card.path, remedy=remedy)
    recipe = card.settings.recipe if seed is None else card.settings.recipe.model_copy(update={"seed": seed})
    if out is None:
        path, digest = cached_mock(recipe, card.name, cache_folder())
    else:
        path, digest = out, make_mock(recipe, out)
    return {"catalogue": card.name, "file": str(path), "sha256": digest, "rows": recipe.n_galaxy, "seed": recipe.seed}
