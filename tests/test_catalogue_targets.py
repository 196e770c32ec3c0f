"""Targets: what programmes take, pairs that one fibre cannot tell apart, and supplies of calibration fibres."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from survey_sim import tables
from survey_sim.catalogue import ProgrammeSettings, Region, make_targets
from survey_sim.catalogue.merging import MAX_PAIRS, merge_close
from survey_sim.errors import InputError
from survey_sim.region import abs_galactic_latitude_deg, healpix_29
from tests import naive_catalogue as naive

ARCSEC = 1.0 / 3600.0


def programme(**values) -> ProgrammeSettings:
    return ProgrammeSettings.load({"name": "stars", "survey": "s", "catalogue": "stars", **values})


def supply(kind: str, **values) -> ProgrammeSettings:
    values = {"name": kind, "survey": "s", "kind": kind, **values}
    return ProgrammeSettings.load(values if kind == "sky" else {"catalogue": "stars", **values})


def write_stars(folder: Path, rows: dict, name: str = "stars") -> None:
    pl.DataFrame(rows).write_parquet(folder / f"{name}.parquet")
    (folder / f"{name}.toml").write_text(f'name = "{name}"\nfile = "{name}.parquet"\n')


def random_stars(n: int, seed: int, ra=(0.0, 360.0), dec=(-90.0, 90.0)) -> dict:
    rng = np.random.default_rng(seed)
    sine = rng.uniform(*np.sin(np.radians(dec)), n)
    return {
        "source_id": [f"x{i}" for i in range(n)],
        "ra_deg": rng.uniform(*ra, n) % 360.0,
        "dec_deg": np.degrees(np.arcsin(sine)),
        "mag": rng.uniform(7.0, 13.0, n).round(2),
    }


def make(folder, *programmes, region=Region(), seed=1, **values):  # noqa: B008 - frozen
    return make_targets(programmes, region, seed, folder, folder / "cache", **values)


def test_a_programme_takes_its_magnitudes_and_footprint(tmp_path):
    rows = random_stars(3000, 1)
    write_stars(tmp_path, rows)
    made = make(tmp_path, programme(mag_bright=9, mag_faint=11, dec_min_deg=-60, dec_max_deg=20, abs_b_min_deg=15, visits=3))
    latitude = abs_galactic_latitude_deg(rows["ra_deg"], rows["dec_deg"])
    wanted = (rows["mag"] >= 9) & (rows["mag"] < 11) & (rows["dec_deg"] >= -60) & (rows["dec_deg"] <= 20) & (latitude > 15)
    assert set(made.targets["source_id"]) == {f"x{i}" for i in np.flatnonzero(wanted)}
    assert made.targets["wanted_visits"].unique().to_list() == [3]
    assert made.targets["tile_id"].is_null().all()
    assert made.n_target == {"s/stars": int(wanted.sum())}
    assert made.counts == {"stars": {"rows": 3000}}
    tables.conform(made.targets, "targets")


def test_galactic_latitude_agrees_with_astropy():
    from astropy.coordinates import SkyCoord

    rows = random_stars(500, 2)
    sky = SkyCoord(rows["ra_deg"], rows["dec_deg"], unit="deg", frame="icrs")
    expected = np.abs(sky.galactic.b.deg)
    np.testing.assert_allclose(abs_galactic_latitude_deg(rows["ra_deg"], rows["dec_deg"]), expected, atol=1e-4)


@pytest.mark.parametrize("ra", [(350.0, 10.0), (0.0, 90.0), (270.0, 360.0)])
def test_region_may_wrap_through_zero(ra):
    region = Region(ra_deg=ra, dec_deg=(-10.0, 10.0))
    places = np.array([0.0, 5.0, 45.0, 100.0, 300.0, 355.0])
    inside = [(p - ra[0]) % 360.0 < (ra[1] - ra[0]) % 360.0 for p in places]
    np.testing.assert_array_equal(region.contains(places, np.zeros(6)), inside)
    assert not region.contains(places, np.full(6, 20.0)).any()


def test_bad_regions():
    for values, rule in [
        ({"ra_deg": [10, 10]}, "must differ"),
        ({"dec_deg": [10, -10]}, "southern"),
        ({"ra_deg": [0, 361]}, "360"),
        ({"dec_deg": [float("nan"), 0]}, "finite"),
    ]:
        with pytest.raises(InputError, match=rule):
            Region.load(values)


def test_identifiers_do_not_depend_on_the_order_of_rows(tmp_path):
    rows = random_stars(4000, 3, ra=(350.0, 370.0), dec=(-10.0, 10.0))
    rows["source_id"][1] = "twin"
    for key in ("ra_deg", "dec_deg", "mag"):  # an exact twin, and many equal magnitudes
        rows[key][1] = rows[key][0]
    mine = [programme(mag_faint=11), supply("guide"), supply("standard"), supply("sky")]
    frames = []
    for seed in (None, 1, 2):
        order = np.arange(4000) if seed is None else np.random.default_rng(seed).permutation(4000)
        write_stars(tmp_path, {key: np.asarray(column)[order] for key, column in rows.items()})
        made = make(tmp_path, *mine)
        frames.append((made.targets, made.rejected))
    for targets, rejected in frames[1:]:
        assert targets.equals(frames[0][0])
        assert rejected.equals(frames[0][1])
    targets = frames[0][0]
    assert targets["target_id"].to_list() == list(range(targets.height))
    keys = targets.select("_healpix_29", "survey", "kind", pl.col("programme").fill_null(""), "source_id")
    assert keys.equals(keys.sort(keys.columns))
    np.testing.assert_array_equal(
        targets["_healpix_29"], healpix_29(targets["ra_deg"].to_numpy(), targets["dec_deg"].to_numpy())
    )


def as_rows(stars: list[tuple[str, float, float, float]]) -> pl.DataFrame:
    frame = pl.DataFrame(stars, schema=["source_id", "ra_deg", "dec_deg", "mag"], orient="row")
    cells = healpix_29(frame["ra_deg"].to_numpy(), frame["dec_deg"].to_numpy())
    return frame.with_columns(_healpix_29=cells, catalogue=pl.lit("c"), order=pl.lit(0))


def test_a_chain_keeps_its_brightest_and_its_far_end():
    step = 3.0 * ARCSEC
    stars = [("a", 10.0, 0.0, 9.0), ("b", 10.0, step, 10.0), ("c", 10.0, 2 * step, 11.0)]
    kept, lost = merge_close(as_rows(stars), 3.3)
    assert set(kept["source_id"]) == {"a", "c"}
    assert lost.select("source_id", "other_source_id", "reason").rows() == [("b", "a", "too-close-pair")]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12), st.integers(0, 3)), max_size=40),
    st.sampled_from([(0.0, 0.0), (359.999, -30.0), (123.0, 89.9995), (0.0, -90.0)]),
)
def test_merging_agrees_with_a_plain_loop(places, corner):
    ra0, dec0 = corner
    stars = [
        (f"x{i:02d}", (ra0 + x * 1.1 * ARCSEC) % 360.0, float(np.clip(dec0 + y * 1.1 * ARCSEC, -90, 90)), float(m))
        for i, (x, y, m) in enumerate(places)
    ]
    if not stars:
        return
    kept, lost = merge_close(as_rows(stars), 3.37)
    expected_kept, expected_lost = naive.merge_close(stars, 3.37)
    assert set(kept["source_id"]) == expected_kept
    assert set(lost["source_id"]) == set(expected_lost)
    assert dict(lost.select("source_id", "other_source_id").rows()) == expected_lost


def test_crowds_that_would_fill_the_memory_are_refused():
    n = int(np.sqrt(2 * MAX_PAIRS)) + 10
    zeros = np.zeros(n)
    frame = pl.DataFrame({"source_id": [str(i) for i in range(n)], "ra_deg": zeros, "dec_deg": zeros, "mag": zeros})
    frame = frame.with_columns(_healpix_29=pl.lit(0), catalogue=pl.lit("c"), order=pl.lit(0))
    with pytest.raises(InputError, match="check the units"):
        merge_close(frame, 3.3)


def test_close_pairs_and_shared_objects_are_rejected_rows(tmp_path):
    rows = {
        "source_id": ["a", "b", "c"],
        "ra_deg": [0.0, 360.0 - 2.0 * ARCSEC, 50.0],
        "dec_deg": [0.0, 0.0, 10.0],
        "mag": [9.0, 10.0, 9.5],
    }
    write_stars(tmp_path, rows)
    made = make(tmp_path, programme(name="one"), programme(name="two", mag_faint=10), programme(name="other", survey="t"))
    assert made.targets.select("survey", "programme", "source_id").sort("survey", "source_id").rows() == [
        ("s", "one", "a"),
        ("s", "one", "c"),
        ("t", "other", "a"),
        ("t", "other", "c"),
    ]
    found = made.rejected.select("survey", "source_id", "reason", "other_source_id").rows()
    assert sorted(found) == [
        ("s", "a", "other-programme", "a"),
        ("s", "b", "too-close-pair", "a"),
        ("s", "c", "other-programme", "c"),
        ("t", "b", "too-close-pair", "a"),
    ]
    assert made.counts == {"stars": {"rows": 3, "other-programme": 2, "too-close-pair": 1}}
    tables.conform(made.rejected, "rejected")
    assert make(tmp_path, programme(fibre_arcsec=1)).targets.height == 3


def test_priorities(tmp_path):
    write_stars(
        tmp_path, {"source_id": ["a", "b", "c"], "ra_deg": [0.0, 1, 2], "dec_deg": [0.0, 0, 0], "mag": [9.0, 11.0, 13.0]}
    )
    bins = [{"mag_bright": 9, "mag_faint": 11, "priority": 9}, {"mag_bright": 11, "mag_faint": 12, "priority": 7}]
    found = {}
    for rule in (None, 3, bins):
        targets = make(tmp_path, programme(priority=rule)).targets.sort("source_id")
        found[str(rule)[:4]] = targets["priority"].to_list()
    assert found == {"None": [5, 5, 5], "3": [3, 3, 3], "[{'m": [9, 7, 1]}


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"kind": "sky", "catalogue": "stars"}, "takes no catalogue"),
        ({"catalogue": None}, "needs one"),
        ({"kind": "guide", "visits": 2}, "visits: only for kind 'science'"),
        ({"mag_bright": 12, "mag_faint": 11}, "mag_bright must be less"),
        ({"dec_min_deg": 10, "dec_max_deg": -10}, "dec_min_deg must be less"),
        ({"visits": 0}, "visits"),
        ({"priority": 10}, "priority"),
        ({"name": "a/b"}, "name"),
        ({"name": "<b>"}, "name"),
        ({"kind": "sience"}, "did you mean 'science'"),
        ({"magfaint": 3}, "did you mean 'mag_faint'"),
        ({"density_per_sq_deg": 3}, "not for kind 'science'"),
        ({"mag_faint": float("nan")}, "mag_faint"),
    ],
)
def test_impossible_programmes(values, rule):
    with pytest.raises(InputError, match=rule):
        programme(**values)


def test_programmes_of_one_name_and_limits_without_magnitudes(tmp_path):
    write_stars(tmp_path, {"source_id": ["a"], "ra_deg": [0.0], "dec_deg": [0.0], "mag": [9.0]})
    with pytest.raises(InputError, match="used more than once in a survey: s/stars"):
        make(tmp_path, programme(), programme())
    (tmp_path / "stars.toml").write_text('name = "stars"\nfile = "stars.parquet"\n[columns]\nsource_id = "source_id"\n')
    assert make(tmp_path, programme()).targets["mag"].to_list() == [None]
    with pytest.raises(InputError, match="without magnitudes"):
        make(tmp_path, programme(mag_faint=10))


def test_no_target_is_a_warning(tmp_path):
    write_stars(tmp_path, random_stars(100, 5))
    made = make(tmp_path, programme(mag_bright=20), supply("sky"), supply("guide"))
    assert made.targets.height == 0
    assert "programme s/stars has no target" in made.warnings
    tables.conform(made.targets, "targets")


# Supplies ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """60,000 stars around the south pole and RA 0; science in a region of it, and all supplies."""
    folder = tmp_path_factory.mktemp("field")
    write_stars(folder, random_stars(60_000, 6, dec=(-90.0, -60.0)))
    mine = (programme(mag_faint=9), supply("guide"), supply("standard", density_per_sq_deg=3), supply("sky"))
    return folder, mine, make(folder, *mine)


def test_sky_is_clear_and_even(field):
    folder, _, made = field
    sky = made.targets.filter(kind="sky")
    stars = pl.read_parquet(folder / "stars.parquet")
    area = 2 * np.pi * (1 - np.sin(np.radians(60))) * (180 / np.pi) ** 2
    assert sky.height / area == pytest.approx(12, rel=0.05)
    assert sky["dec_deg"].max() <= stars["dec_deg"].max()
    distance = [
        min(naive.angle_deg(place, other) for other in near)
        for place in sky.select("ra_deg", "dec_deg").rows()[::200]
        if (near := stars.filter((pl.col("dec_deg") - place[1]).abs() < 0.3).select("ra_deg", "dec_deg").rows())
    ]
    assert min(distance) >= 30 * ARCSEC
    assert sky["mag"].is_null().all()
    assert sky["programme"].is_null().all()
    assert sky["source_id"].is_unique().all()


def test_sky_of_a_region_is_that_of_the_whole(field):
    folder, mine, whole = field
    part = make(folder, *mine, region=Region(ra_deg=(340.0, 20.0), dec_deg=(-80.0, -70.0)))
    names = set(part.targets.filter(kind="sky")["source_id"])
    assert names < set(whole.targets.filter(kind="sky")["source_id"])
    science = part.targets.filter(kind="science")
    assert science["dec_deg"].is_between(-80, -70).all()
    # On every plate that holds a science target, all sky positions of the whole run are there.
    corner = science.sort("dec_deg").row(0, named=True)
    wanted = [
        name
        for name, ra, dec in whole.targets.filter(kind="sky").select("source_id", "ra_deg", "dec_deg").rows()
        if naive.angle_deg((ra, dec), (corner["ra_deg"], corner["dec_deg"])) < 6.1
    ]
    assert wanted
    assert names.issuperset(wanted)


def test_sky_depends_on_the_seed_alone(field):
    folder, mine, whole = field
    again = make(folder, *mine, seed=2).targets.filter(kind="sky")
    assert not set(again["_healpix_29"]) & set(whole.targets.filter(kind="sky")["_healpix_29"])
    assert make(folder, *mine).targets.equals(whole.targets)


def test_sky_where_nothing_is_clear(tmp_path):
    write_stars(tmp_path, random_stars(2000, 7, ra=(0.0, 3.0), dec=(0.0, 3.0)))
    made = make(tmp_path, programme(), supply("sky", clearance_arcsec=3600), calibration_reach_deg=0.1)
    sky = made.targets.filter(kind="sky")
    inside = sky.filter(pl.col("ra_deg").is_between(0.5, 2.5), pl.col("dec_deg").is_between(0.5, 2.5))
    assert inside.height == 0


def test_guides_and_standards(field):
    _, _, made = field
    for kind, bright, faint, density in [("guide", 8, 11, 40), ("standard", 9, 12, 3)]:
        stars = made.targets.filter(kind=kind)
        assert stars["mag"].is_between(bright, faint, closed="left").all()
        assert stars["wanted_visits"].to_list() == [0] * stars.height
        assert stars["programme"].is_null().all()
        area = 2 * np.pi * (1 - np.sin(np.radians(60))) * (180 / np.pi) ** 2
        assert stars.height / area <= density * 1.06  # a whole number a cell
    # There are 22 stars of 9 to 12 per sq deg: the supply is full, and of the brighter half.
    standards = made.targets.filter(kind="standard")
    assert standards.height / area > 2.8
    assert standards["mag"].median() < 9.7
    science = set(made.targets.filter(kind="science")["source_id"])
    assert science & set(made.targets.filter(kind="guide")["source_id"]), "a star may be both, in two rows"
