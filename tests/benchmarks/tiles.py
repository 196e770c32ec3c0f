"""One tile as a run has it: clustered galaxies, with all supplies of calibration fibres."""

import numpy as np
import polars as pl

from survey_sim.allocation import AllocationSettings
from survey_sim.geometry import plate_to_sky
from survey_sim.instrument import load_instrument, make_plate
from survey_sim.routing import RoutingSettings
from survey_sim.survey.tile import TileJob
from tests.mock_targets import PLATE_RADIUS_MM, clustered_xy, uniform_xy

CENTRE_DEG = (150.0, -30.0)
N_SUPPLY = {"standard": 350, "sky": 350, "guide": 1200}


def tile_job(n_science: int, instrument: str = "taipan-150", tile_id: int = 0, **allocation: object) -> TileJob:
    """A tile of so many science targets, all wanted once, nine in ten of them enough."""
    places = np.vstack([clustered_xy(n_science, tile_id + 1), uniform_xy(sum(N_SUPPLY.values()), tile_id + 1)])
    kinds = ["science"] * n_science + [kind for kind, n in N_SUPPLY.items() for _ in range(n)]
    plate = make_plate(load_instrument(instrument))
    xy = places * plate.instrument.plate_radius_mm / PLATE_RADIUS_MM
    sky = plate_to_sky(xy, CENTRE_DEG, plate.instrument.plate_scale_arcsec_mm)
    targets = pl.DataFrame(
        {
            "target_id": np.arange(len(xy)),
            "kind": kinds,
            "programme": ["galaxies" if kind == "science" else None for kind in kinds],
            "ra_deg": sky[:, 0],
            "dec_deg": sky[:, 1],
            "mag": np.linspace(14.0, 17.0, len(xy)),
            "priority": 5,
            "wanted_visits": [int(kind == "science") for kind in kinds],
        }
    )
    return TileJob(
        survey="taipan", tile_id=tile_id, centre_deg=CENTRE_DEG, targets=targets, wanted_frac={"galaxies": 0.9},
        plate=plate, allocation=AllocationSettings.load(allocation), routing=RoutingSettings(), seed=1,
    )  # fmt: skip
