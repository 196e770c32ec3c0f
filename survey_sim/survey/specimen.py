"""A small survey of random stars in a folder, for whatever must run one: the compiling of kernels, the conformance tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

_PROGRAMME = '[[programme]]\nname = "{kind}"\nsurvey = "stars"\nkind = "{kind}"\n{catalogue}\n'
_REGION = "[tiling]\nregion = {{ ra_deg = [10.0, {ra_max:.3f}], dec_deg = [-32.0, -28.0] }}\n"


def write_specimen(folder: Path, sections: str = "", n_star: int = 300, width_deg: float = 4.0, seed: int = 1) -> Path:
    """Write the catalogue and the pipeline; all kinds of targets are drawn from the same stars.

    Parameters
    ----------
    sections
        TOML text of further sections.
    width_deg
        Of the region in right ascension; 4 deg are one tile.

    Returns
    -------
        Path of the pipeline.
    """
    rng = np.random.default_rng(seed)
    stars = pl.DataFrame(
        {
            "source_id": [str(i) for i in range(n_star)],
            "ra_deg": 10.0 + width_deg * rng.random(n_star),
            "dec_deg": -32.0 + 4.0 * rng.random(n_star),
            "mag": 8.0 + 3.0 * rng.random(n_star),
        }
    )
    folder.mkdir(parents=True, exist_ok=True)
    stars.write_csv(folder / "stars.csv")
    kinds = ("science", "standard", "guide", "sky")
    programmes = [_PROGRAMME.format(kind=k, catalogue="" if k == "sky" else 'catalogue = "stars.csv"') for k in kinds]
    pipeline = folder / "specimen.toml"
    text = "\n".join([_REGION.format(ra_max=10.0 + width_deg), *programmes, sections])
    pipeline.write_text(text, encoding="utf-8")
    return pipeline
