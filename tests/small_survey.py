"""A small survey for tests: 900 stars on both sides of right ascension 0, and a pipeline for them."""

from pathlib import Path

import numpy as np
import polars as pl

PIPELINE = """
[run]
seed = 7

[instrument]
preset = "taipan-150"

[tiling]
region = { ra_deg = [354.0, 6.0], dec_deg = [-36.0, -28.0] }

[[programme]]
name = "bright"
survey = "stars"
catalogue = "stars.csv"
mag_faint = 10.0
exposure_s = 300.0
visits = 2
priority = 8

[[programme]]
name = "faint"
survey = "stars"
catalogue = "stars.csv"
mag_bright = 10.0
exposure_s = 600.0
completeness_frac = 0.9

[[programme]]
name = "guides"
survey = "stars"
kind = "guide"
catalogue = "stars.csv"

[[programme]]
name = "standards"
survey = "stars"
kind = "standard"
catalogue = "stars.csv"

[[programme]]
name = "sky"
survey = "stars"
kind = "sky"

[allocation]
algorithm = "cda-basic"

[routing]
router = "simple-vector"

[schedule]
start_date = 2016-10-01
end_date = 2016-10-12

[output]
tiles_per_part = 1
"""


def write_small_survey(folder: Path, *, shuffle: int | None = None) -> Path:
    """Write stars.csv and small.toml into a folder; gives the pipeline's path."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(11)
    n = 900
    stars = pl.DataFrame(
        {
            "source_id": [f"star-{i:04d}" for i in range(n)],
            "ra_deg": (354.0 + 12.0 * rng.random(n)) % 360.0,
            "dec_deg": -36.0 + 8.0 * rng.random(n),
            "mag": 8.0 + 4.0 * np.sqrt(rng.random(n)),
        }
    )
    if shuffle is not None:
        stars = stars.sample(fraction=1.0, shuffle=True, seed=shuffle)
    stars.write_csv(folder / "stars.csv")
    pipeline = folder / "small.toml"
    pipeline.write_text(PIPELINE)
    return pipeline
