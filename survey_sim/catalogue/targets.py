"""Targets of a run: what each programme takes from its catalogue, and the supplies of calibration fibres.

A science target is an object of one survey, wanted by one programme; the same object may be a target of two surveys, in two
rows. Standards, guides and sky positions are rows of their own, with no home tile: any visit of their survey may use them.
A star that is both a science target and a standard or guide has a row as each: only the science row counts for completeness,
and no visit can use both, as two robots at one place would break the separation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.spatial import cKDTree

from survey_sim import tables
from survey_sim.catalogue.cards import CardSettings, load_card
from survey_sim.catalogue.merging import merge_close
from survey_sim.catalogue.ordering import content_order
from survey_sim.catalogue.reading import Catalogue, read_catalogue
from survey_sim.catalogue.settings import PriorityBin, PriorityRule, ProgrammeSettings
from survey_sim.catalogue.sky_positions import cells_of, sky_positions
from survey_sim.errors import InputError
from survey_sim.geometry import chord, unit_vectors
from survey_sim.region import HEALPIX_ORDER, SPHERE_SQ_DEG, Region, abs_galactic_latitude_deg, healpix_29, healpix_positions

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Two field radii of the TAIPAN plate: a plate that holds a science target reaches no further from it.
CALIBRATION_REACH_DEG = 6.2
DEFAULT_PRIORITY = 5
# Supplies are thinned in HEALPix cells that hold at least so many of those wanted: fine enough to stay even.
_N_WANTED_A_CELL = 8
# Order of the HEALPix cells in which the reach of calibration rows is kept: 0.9 deg wide.
_REACH_ORDER = 6
_Keep = Callable[[FloatArray, FloatArray], BoolArray]
_COLUMNS = (
    "survey",
    "programme",
    "kind",
    "source_id",
    "ra_deg",
    "dec_deg",
    "mag",
    "priority",
    "wanted_visits",
    "_healpix_29",
)


@dataclass(frozen=True)
class Targets:
    """What `make_targets` gives.

    Attributes
    ----------
    targets
        Table `targets`, `tile_id` null.
    rejected
        Table `rejected`.
    counts
        Of each catalogue: rows read, and rows rejected by reason.
    n_target
        Of each "survey/programme": targets.
    checksums
        SHA-256 of each catalogue's file, by the card's name.
    warnings
        What is probably not meant: a programme with no target.
    """

    targets: pl.DataFrame
    rejected: pl.DataFrame
    counts: Mapping[str, Mapping[str, int]]
    n_target: Mapping[str, int]
    checksums: Mapping[str, str]
    warnings: Sequence[str]


def make_targets(
    programmes: Sequence[ProgrammeSettings],
    region: Region,
    seed: int,
    catalogues_folder: Path,
    cache_dir: Path,
    *,
    calibration_reach_deg: float = CALIBRATION_REACH_DEG,
    mock_seed: int | None = None,
) -> Targets:
    """Targets of all programmes, from their catalogues.

    Parameters
    ----------
    region
        Limits science targets. Calibration rows are taken as far beyond as `calibration_reach_deg` from a science target of
        their survey: on any plate that holds one.
    seed
        Of the sky positions.
    mock_seed
        Of mock catalogues; the seed in its card if None.

    Raises
    ------
    InputError
        Two programmes of one name, or a catalogue that cannot be read.
    """
    _check_names(programmes)
    catalogues = _read_all(programmes, catalogues_folder, cache_dir, mock_seed)
    objects = _all_positions(catalogues)
    tree = cKDTree(unit_vectors(*objects.T), balanced_tree=False)
    taken: list[pl.DataFrame] = []
    lost: list[pl.DataFrame] = []
    for survey in dict.fromkeys(programme.survey for programme in programmes):
        mine = [programme for programme in programmes if programme.survey == survey]
        science, rejected = _stars(mine, "science", catalogues, region.contains)
        near = _reach(science, calibration_reach_deg)
        lost += [rejected, *_bad_rows(mine, catalogues)]
        taken.append(science)
        for kind in ("standard", "guide"):
            stars, rejected = _stars(mine, kind, catalogues, near)
            taken.append(stars)
            lost.append(rejected)
        taken += [_sky(programme, near, objects, tree, seed) for programme in mine if programme.kind == "sky"]
    targets = _numbered(taken)
    rejected = _rejected(lost)
    n_target = _count_programmes(programmes, taken)
    return Targets(
        targets=targets,
        rejected=rejected,
        counts=_counts(catalogues, rejected),
        n_target=n_target,
        checksums={catalogue.card.name: catalogue.sha256 for catalogue in catalogues.values()},
        warnings=[f"programme {name} has no target" for name, n in n_target.items() if n == 0],
    )


def _check_names(programmes: Sequence[ProgrammeSettings]) -> None:
    names = [f"{programme.survey}/{programme.name}" for programme in programmes]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        rule = f"used more than once in a survey: {', '.join(repeated)}"
        raise InputError(rule, place="programme.name", remedy="give each programme a name of its own")


def _read_all(
    programmes: Sequence[ProgrammeSettings], folder: Path, cache_dir: Path, mock_seed: int | None
) -> dict[str, Catalogue]:
    """Each catalogue once, by what the programmes call it."""
    catalogues: dict[str, Catalogue] = {}
    for programme in programmes:
        if programme.catalogue is not None and programme.catalogue not in catalogues:
            card = load_card(programme.catalogue, folder)
            catalogues[programme.catalogue] = read_catalogue(card, cache_dir, mock_seed=mock_seed)
    names = [catalogue.card.name for catalogue in catalogues.values()]
    if len(set(names)) < len(names):
        rule = f"two catalogues have the same name, among {', '.join(sorted(names))}"
        raise InputError(rule, place="programme.catalogue", remedy="name each catalogue in one way, each card differently")
    return catalogues


def _stars(
    programmes: Sequence[ProgrammeSettings], kind: str, catalogues: Mapping[str, Catalogue], keep: _Keep
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Targets of one kind of a survey's programmes, each object once, and those rejected."""
    mine = [programme for programme in programmes if programme.kind == kind]
    selected = [
        _select(place, programme, catalogues[str(programme.catalogue)], keep) for place, programme in enumerate(mine)
    ]
    if not selected:
        return _no_target(), pl.DataFrame()
    fibre_arcsec = max(programme.fibre_arcsec for programme in programmes)
    rows, rejected = merge_close(pl.concat(selected), fibre_arcsec)
    return rows.select(_COLUMNS), rejected


def _select(place: int, programme: ProgrammeSettings, catalogue: Catalogue, keep: _Keep) -> pl.DataFrame:
    """Rows that a programme takes from its catalogue, in the columns of targets, with `catalogue` and `order`."""
    card = catalogue.card.settings
    rows = catalogue.rows.filter(_limits(programme, catalogue))
    rows = rows.filter(keep(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy()))
    if programme.abs_b_min_deg > 0:
        latitude = abs_galactic_latitude_deg(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy())
        rows = rows.filter(latitude > programme.abs_b_min_deg)
    rows = rows.with_columns(_healpix_29=healpix_29(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy()))
    if programme.density_per_sq_deg is not None:
        rows = _thin(rows, programme.density_per_sq_deg)
    is_science = programme.kind == "science"
    return rows.select(
        pl.lit(programme.survey).alias("survey"),
        pl.lit(programme.name if is_science else None, dtype=pl.String).alias("programme"),
        pl.lit(programme.kind).alias("kind"),
        "source_id",
        "ra_deg",
        "dec_deg",
        "mag",
        _priority(programme, card, "priority" in rows.columns).cast(pl.Int8).alias("priority"),
        pl.lit(programme.visits if is_science else 0, dtype=pl.Int16).alias("wanted_visits"),
        "_healpix_29",
        pl.lit(card.name).alias("catalogue"),
        pl.lit(place, dtype=pl.Int32).alias("order"),
    )


def _limits(programme: ProgrammeSettings, catalogue: Catalogue) -> pl.Expr:
    """Whether a row is within a programme's declinations and magnitudes, and its own in a catalogue of several."""
    card = catalogue.card.settings
    bright = max((m for m in (programme.mag_bright, card.mag_bright) if m is not None), default=None)
    faint = min((m for m in (programme.mag_faint, card.mag_faint) if m is not None), default=None)
    if card.columns.mag is None and (bright is not None or faint is not None):
        remedy = "map columns.mag in the card, or take the limits out"
        raise InputError("magnitude limits on a catalogue without magnitudes", place=programme.name, remedy=remedy)
    rules = [pl.col("dec_deg").is_between(programme.dec_min_deg, programme.dec_max_deg)]
    if bright is not None:
        rules.append(pl.col("mag") >= bright)
    if faint is not None:
        rules.append(pl.col("mag") < faint)
    if card.columns.programme is not None:
        rules.append(pl.col("programme") == programme.name)
    return pl.all_horizontal(rules)


def _priority(programme: ProgrammeSettings, card: CardSettings, has_column: bool) -> pl.Expr:
    """Priority by the programme's rule, else the catalogue's own column, else the card's rule, else the middle one."""
    if programme.priority is not None:
        return _by_rule(programme.priority)
    if has_column:
        return pl.col("priority")
    return _by_rule(card.priority if card.priority is not None else DEFAULT_PRIORITY)


def _by_rule(rule: PriorityRule) -> pl.Expr:
    if isinstance(rule, int):
        return pl.lit(rule)
    first: list[PriorityBin] = list(rule)
    fits = [(pl.col("mag") >= bin_.mag_bright) & (pl.col("mag") < bin_.mag_faint) for bin_ in first]
    return pl.coalesce(
        *(pl.when(fit).then(pl.lit(bin_.priority)) for fit, bin_ in zip(fits, first, strict=True)),
        pl.lit(1),
    )


def _thin(rows: pl.DataFrame, density_per_sq_deg: float) -> pl.DataFrame:
    """At most so many rows per square degree: the brightest of each HEALPix cell, ties by source_id."""
    n_cell = density_per_sq_deg * SPHERE_SQ_DEG / _N_WANTED_A_CELL
    order = int(np.clip(np.floor(np.log(max(n_cell / 12, 1.0)) / np.log(4)), 0, HEALPIX_ORDER))
    n_wanted = max(1, round(density_per_sq_deg * SPHERE_SQ_DEG / (12 * 4**order)))
    cell = rows["_healpix_29"].to_numpy() >> (2 * (HEALPIX_ORDER - order))
    mag = rows["mag"].fill_null(np.inf).to_numpy()
    ranked = content_order((cell, mag, rows["_healpix_29"].to_numpy()), rows["source_id"])
    place = np.arange(len(ranked)) - np.searchsorted(cell[ranked], cell[ranked])
    return rows[np.sort(ranked[place < n_wanted])]


def _reach(science: pl.DataFrame, reach_deg: float) -> _Keep:
    """Whether positions are within reach of a science target, by cells: never too few, up to two cells too many."""
    cell = pl.col("_healpix_29").floordiv(4 ** (HEALPIX_ORDER - _REACH_ORDER))
    occupied = science.select(cell.unique()).to_series().to_numpy()
    within = np.zeros(12 * 4**_REACH_ORDER, dtype=np.bool_)
    if len(occupied):
        import healpy  # noqa: PLC0415 - 0.5 s that the command line's help need not pay

        centres = unit_vectors(*healpix_positions(np.arange(len(within)), _REACH_ORDER))
        cell_deg = 2.0 * float(np.degrees(healpy.max_pixrad(2**_REACH_ORDER)))
        nearest, _ = cKDTree(centres[occupied]).query(centres, distance_upper_bound=chord(min(reach_deg + cell_deg, 180.0)))
        within = np.isfinite(nearest)

    def keep(ra_deg: FloatArray, dec_deg: FloatArray) -> BoolArray:
        return within[healpix_29(ra_deg, dec_deg) >> (2 * (HEALPIX_ORDER - _REACH_ORDER))]

    return keep


def _all_positions(catalogues: Mapping[str, Catalogue]) -> FloatArray:
    """(n, 2) right ascension and declination of every object of every catalogue, those that cannot be targets included."""
    frames = [
        frame.select("ra_deg", "dec_deg")
        for catalogue in catalogues.values()
        for frame in (catalogue.rows, catalogue.rejected)
    ]
    if not frames:
        return np.empty((0, 2))
    is_on_sky = pl.col("ra_deg").is_between(0, 360) & pl.col("dec_deg").is_between(-90, 90)
    return pl.concat(frames).filter(is_on_sky).to_numpy()


def _sky(programme: ProgrammeSettings, keep: _Keep, objects: FloatArray, tree: cKDTree, seed: int) -> pl.DataFrame:
    """Sky positions of a survey, within reach of its science targets and in the declinations of the objects known."""
    if not len(objects):
        return _no_target()
    south = max(programme.dec_min_deg, float(objects[:, 1].min()))
    north = min(programme.dec_max_deg, float(objects[:, 1].max()))
    cells = cells_of((south, north), keep)
    rows = sky_positions(cells, programme.density_per_sq_deg or 0.0, programme.clearance_arcsec, tree, seed)
    ra_deg, dec_deg = rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy()
    inside = keep(ra_deg, dec_deg) & (dec_deg >= south) & (dec_deg <= north)
    if programme.abs_b_min_deg > 0:
        inside &= abs_galactic_latitude_deg(ra_deg, dec_deg) > programme.abs_b_min_deg
    return rows.filter(inside).select(
        pl.lit(programme.survey).alias("survey"),
        pl.lit(None, dtype=pl.String).alias("programme"),
        pl.lit("sky").alias("kind"),
        "source_id",
        "ra_deg",
        "dec_deg",
        pl.lit(None, dtype=pl.Float64).alias("mag"),
        pl.lit(programme.priority if isinstance(programme.priority, int) else DEFAULT_PRIORITY, dtype=pl.Int8).alias(
            "priority"
        ),
        pl.lit(0, dtype=pl.Int16).alias("wanted_visits"),
        "_healpix_29",
    )


def _no_target() -> pl.DataFrame:
    return tables.empty("targets").select(_COLUMNS)


def _numbered(parts: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """All targets sorted by (_healpix_29, survey, kind, programme, source_id), numbered in that order."""
    frame = pl.concat([_no_target(), *parts])
    codes = [_code(frame[name]) for name in ("survey", "kind", "programme")]
    code = (codes[0] * (codes[1].max(initial=0) + 1) + codes[1]) * (codes[2].max(initial=0) + 1) + codes[2]
    order = content_order((frame["_healpix_29"].to_numpy(), code), frame["source_id"])
    frame = frame[order].with_columns(target_id=pl.int_range(pl.len(), dtype=pl.Int64), tile_id=pl.lit(None, dtype=pl.Int32))
    return frame.select(tables.empty("targets").columns)


def _code(words: pl.Series) -> npt.NDArray[np.int64]:
    """(n,) place of each word in alphabetical order, null before all."""
    known = pl.Enum(words.drop_nulls().unique().sort())
    return (words.cast(known).to_physical().cast(pl.Int64) + 1).fill_null(0).to_numpy()


def _bad_rows(programmes: Sequence[ProgrammeSettings], catalogues: Mapping[str, Catalogue]) -> list[pl.DataFrame]:
    """Rows that could not be read, of the catalogues that a survey uses."""
    names = {programme.catalogue for programme in programmes if programme.catalogue is not None}
    survey = pl.lit(programmes[0].survey).alias("survey")
    return [catalogues[name].rejected.with_columns(survey) for name in sorted(names)]


def _rejected(parts: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """Table `rejected`: a row rejected twice for the same reason (as standard and as guide) is there once."""
    columns = tables.empty("rejected").columns
    frame = pl.concat([tables.empty("rejected"), *(part.select(columns) for part in parts if part.height)])
    return frame.unique(("catalogue", "survey", "source_id", "reason"), keep="first", maintain_order=True).sort(columns[:3])


def _counts(catalogues: Mapping[str, Catalogue], rejected: pl.DataFrame) -> dict[str, dict[str, int]]:
    counts = {c.card.name: {"rows": c.rows.height + c.rejected.height} for c in catalogues.values()}
    grouped = rejected.group_by("catalogue", "reason").agg(pl.col("source_id").n_unique()).sort("catalogue", "reason")
    for name, reason, n in grouped.iter_rows():
        counts[name][reason] = n
    return counts


def _count_programmes(programmes: Sequence[ProgrammeSettings], parts: Sequence[pl.DataFrame]) -> dict[str, int]:
    """Targets of each "survey/programme" (science), and of each "survey/kind" of supply."""
    name = pl.concat_str("survey", pl.coalesce("programme", "kind"), separator="/")
    found: dict[str, int] = {}
    for part in parts:
        found |= dict(part.group_by(name.alias("name")).len().iter_rows())
    wanted = (f"{p.survey}/{p.name if p.kind == 'science' else p.kind}" for p in programmes)
    return {key: found.get(key, 0) for key in wanted}
