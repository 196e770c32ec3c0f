"""Synthetic inputs of the schedule: tiles, visits and targets with made-up configuration times."""

from dataclasses import dataclass

import numpy as np
import polars as pl

from survey_sim.geometry import unit_vectors
from survey_sim.schedule import Programme
from survey_sim.schema import PATHS


@dataclass(frozen=True)
class Inputs:
    """Arguments of `make_schedule` that are tables, and the programmes."""

    visits: pl.DataFrame
    paths: pl.DataFrame
    tiles: pl.DataFrame
    targets: pl.DataFrame
    holdings: pl.DataFrame
    programmes: tuple[Programme, ...]

    def arguments(self):
        return self.visits, self.paths, self.tiles, self.targets, self.holdings, self.programmes


def sphere_points(n, rng):
    """n directions over the whole sky, evenly spaced (Fibonacci lattice), turned at random in right ascension."""
    place = np.arange(n) + 0.5
    ra_deg = (place * 180.0 * (3.0 - np.sqrt(5.0)) + rng.uniform(0.0, 360.0)) % 360.0
    return ra_deg, np.degrees(np.arcsin(1.0 - 2.0 * place / n))


def one_survey(survey, programme, ra_deg, dec_deg, visits_of_tile, n_held, wanted=1, first_id=0, rng=None):
    """Tables of one survey: every visit holds `n_held` targets of its tile, each held at `wanted` visits."""
    rng = rng or np.random.default_rng(0)
    n_tile = len(ra_deg)
    visits_of_tile = np.broadcast_to(visits_of_tile, n_tile)
    tile = np.repeat(np.arange(n_tile), visits_of_tile)
    visit = np.concatenate([np.arange(n) for n in visits_of_tile] + [[]]).astype(np.int64)
    n_visit = len(tile)
    targets_of_tile = visits_of_tile * n_held // wanted
    first_of_tile = first_id + np.concatenate([[0], np.cumsum(targets_of_tile)[:-1]]) if n_tile else np.empty(0, int)
    slot = (visit[:, None] * n_held + np.arange(n_held)) % np.maximum(targets_of_tile[tile], 1)[:, None]
    held = pl.DataFrame({"tile_id": np.repeat(tile, n_held), "visit_id": np.repeat(visit, n_held)}).with_columns(
        survey=pl.lit(survey), target_id=(first_of_tile[tile][:, None] + slot).ravel()
    )
    n_target = int(targets_of_tile.sum())
    targets = pl.DataFrame({"target_id": first_id + np.arange(n_target)}).with_columns(
        survey=pl.lit(survey), programme=pl.lit(programme), kind=pl.lit("science"), wanted_visits=pl.lit(wanted)
    )
    tiles = pl.DataFrame({"tile_id": np.arange(n_tile), "ra_deg": ra_deg, "dec_deg": dec_deg}).with_columns(
        survey=pl.lit(survey)
    )
    visits = pl.DataFrame({"tile_id": tile, "visit_id": visit}).with_columns(
        survey=pl.lit(survey), start=pl.lit("previous"), n_science=pl.lit(n_held)
    )
    times_s = rng.uniform(20.0, 45.0, (len(PATHS), n_visit))
    paths = pl.concat(
        [
            visits.select("survey", "tile_id", "visit_id").with_columns(
                path=pl.lit(path), configuration_time_s=pl.Series(times_s[row])
            )
            for row, path in enumerate(PATHS)
        ]
    )
    return visits, paths, tiles, targets, held


def join(parts, programmes):
    """One `Inputs` of the tables of several surveys."""
    return Inputs(*(pl.concat(tables, how="diagonal") for tables in zip(*parts, strict=True)), tuple(programmes))


def both_surveys(n_taipan_tile, n_funnelweb_tile, n_visit, n_held=120, seed=1):
    """TAIPAN and FunnelWeb over the southern sky, `n_visit` visits in all, a third of them TAIPAN's."""
    rng = np.random.default_rng(seed)
    parts, first_id = [], 0
    for survey, programme, n_tile, share, wanted, dec_max in (
        ("funnelweb", "stars", n_funnelweb_tile, 2 / 3, 1, 30.0),
        ("taipan", "galaxies", n_taipan_tile, 1 / 3, 2, 10.0),
    ):
        ra_deg, dec_deg = sphere_points(int(2 * n_tile / (1.0 + np.sin(np.radians(dec_max)))), rng)
        is_south = dec_deg < dec_max
        ra_deg, dec_deg = ra_deg[is_south], dec_deg[is_south]
        visits_of_tile = np.maximum(1, rng.poisson(share * n_visit / len(ra_deg), len(ra_deg)))
        parts.append(one_survey(survey, programme, ra_deg, dec_deg, visits_of_tile, n_held, wanted, first_id, rng))
        first_id += len(parts[-1][3])
    programmes = (Programme("stars", "funnelweb", 180.0, 0.95), Programme("galaxies", "taipan", 1800.0, 0.7))
    return join(parts, programmes)


def crowded_surveys(n_visit, wanted, n_held=40, n_tile=(1_700, 1_000), seed=1):
    """FunnelWeb crowded towards the Galactic plane and TAIPAN away from it, 40 % of the visits TAIPAN's.

    `wanted`: visits that each galaxy wants; `n_tile`: of FunnelWeb and TAIPAN.
    """
    rng = np.random.default_rng(seed)
    pole = unit_vectors(np.array([192.86]), np.array([27.13]))[0]
    parts, first_id = [], 0
    for survey, programme, n, share, visits_wanted, dec_max in (
        ("funnelweb", "stars", n_tile[0], 0.6, 1, 30.0),
        ("taipan", "galaxies", n_tile[1], 0.4, wanted, 10.0),
    ):
        ra_deg, dec_deg = sphere_points(int(2 * n / (1 + np.sin(np.radians(dec_max)))), rng)
        is_south = dec_deg < dec_max
        ra_deg, dec_deg = ra_deg[is_south], dec_deg[is_south]
        latitude_rad = np.abs(np.arcsin(unit_vectors(ra_deg, dec_deg) @ pole))
        is_away = np.degrees(latitude_rad) > 10.0
        density = np.exp(-latitude_rad / 0.35) + 0.2 if survey == "funnelweb" else is_away.astype(float)
        visits_of_tile = rng.poisson(density / density.sum() * share * n_visit)
        parts.append(one_survey(survey, programme, ra_deg, dec_deg, visits_of_tile, n_held, visits_wanted, first_id, rng))
        first_id += len(parts[-1][3])
    return join(parts, (Programme("stars", "funnelweb", 180.0), Programme("galaxies", "taipan", 1800.0)))
