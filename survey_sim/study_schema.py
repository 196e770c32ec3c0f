"""Tables that studies of finished runs make: comparisons of scenarios, the imprint of the allocation, selection weights."""

from collections.abc import Mapping

from survey_sim.schema import FLOAT, INT32, INT64, NIGHT, SURVEY, TABLES, TARGET_ID, TEXT, Column, Table

SCENARIO = Column("scenario", TEXT, "", "meta.id", "scenario that the row belongs to")
SEED = Column("seed", INT64, "", "meta.id", "seed of the run's sky and weather: runs of one seed are a pair")
OF = Column("of", TEXT, "", "meta.id", "programme or survey that it is measured of; all: the whole run")
MEASURE = Column("measure", TEXT, "", "meta.id", "what is measured; its name ends in its unit")
UNIT = Column("unit", TEXT, "", "meta.unit", "unit of the row's values (VOUnit syntax)")
OUTCOME = Column("outcome", TEXT, "", "meta.code", "complete as: allocated (robots reach it) or observed (on the nights)")
PROGRAMME_NAME = Column("programme", TEXT, "", "meta.id;obs.proposal", "science case")
N = Column("n", INT64, "", "meta.number", "targets in the bin")
FRAC = Column("completeness_frac", FLOAT, "", "stat.value", "share of them that is complete", True)
FRAC_ERROR = Column("completeness_error_frac", FLOAT, "", "stat.error", "binomial standard error of it", True)


def _value(name: str, ucd: str, what: str, *, is_nullable: bool = False) -> Column:
    return Column(name, FLOAT, "", ucd, what, is_nullable)


def _count(name: str, what: str) -> Column:
    return Column(name, INT32, "", "meta.number", what)


_STUDY_TABLES = (
    Table(
        "measures",
        "a measure of a run (`survey-sim compare`)",
        (
            SCENARIO,
            SEED,
            OF,
            MEASURE,
            UNIT,
            _value("value", "stat.value", "the measure, in its unit; null: the run has none", is_nullable=True),
        ),
        key=("scenario", "seed", "of", "measure"),
        order=("scenario", "seed", "of", "measure"),
    ),
    Table(
        "comparison",
        "a measure of a scenario against that of the reference (`survey-sim compare`)",
        (
            SCENARIO,
            Column("reference", TEXT, "", "meta.id", "scenario that it is compared to"),
            OF,
            MEASURE,
            UNIT,
            _count("n_seed", "seeds with a value"),
            _value("mean", "stat.mean", "mean over seeds", is_nullable=True),
            _value("mean_error", "stat.error", "its standard error; null with fewer than two seeds", is_nullable=True),
            _count("n_pair", "seeds with a value in both scenarios"),
            _value("difference", "stat.mean", "mean over pairs of scenario less reference", is_nullable=True),
            _value("difference_error", "stat.error", "its standard error; null with fewer than two pairs", is_nullable=True),
            _value("difference_low", "stat.min", "lower end of its 95 % interval (Student's t)", is_nullable=True),
            _value("difference_high", "stat.max", "upper end of its 95 % interval (Student's t)", is_nullable=True),
        ),
        key=("scenario", "of", "measure"),
        order=("scenario", "of", "measure"),
    ),
    Table(
        "completeness_curves",
        "a programme's completeness after a night of a run (`survey-sim compare`)",
        (SCENARIO, SEED, PROGRAMME_NAME, NIGHT, _value("completeness_frac", "stat.value", "completeness after the night")),
        key=("scenario", "seed", "programme", "night"),
        order=("scenario", "seed", "programme", "night"),
    ),
    Table(
        "configuration_quantiles",
        "a quantile of the configuration times of a scenario, all seeds together (`survey-sim compare`)",
        (
            SCENARIO,
            SURVEY,
            Column("quantile_frac", FLOAT, "", "stat.value", "share of start-to-target paths that take no longer"),
            Column("configuration_time_s", FLOAT, "s", "time.duration", "when all robots are at rest"),
            Column("configuration_time_p95_s", FLOAT, "s", "time.duration", "when 95 % of the moving robots are at rest"),
            Column("readout_s", FLOAT, "s", "time.duration", "readout of the CCD; null: the runs have no schedule", True),
        ),
        key=("scenario", "survey", "quantile_frac"),
        order=("scenario", "survey", "quantile_frac"),
    ),
    Table(
        "imprint_pairs",
        "a bin of pair separation (`survey-sim imprint`, docs/imprint.md)",
        (
            SCENARIO,
            PROGRAMME_NAME,
            OUTCOME,
            Column("separation_low_deg", FLOAT, "deg", "pos.angDistance;stat.min", "lower edge of the bin"),
            Column("separation_high_deg", FLOAT, "deg", "pos.angDistance;stat.max", "upper edge of the bin"),
            Column("n_pair", INT64, "", "meta.number", "pairs of targets"),
            _value("pair_completeness_frac", "stat.value", "pairs with both targets complete / pairs", is_nullable=True),
            _value("pair_completeness_error_frac", "stat.error", "its jackknife error", is_nullable=True),
            _value("ratio", "stat.value", "(1 + w observed) / (1 + w targeted): normalised DD / DD", is_nullable=True),
            _value("ratio_error", "stat.error", "its jackknife error", is_nullable=True),
            _value("w_targeted", "stat.correlation", "two-point correlation of targets (Landy-Szalay)", is_nullable=True),
            _value("w_observed", "stat.correlation", "two-point correlation of complete targets", is_nullable=True),
        ),
        key=("scenario", "programme", "outcome", "separation_low_deg"),
        order=("scenario", "programme", "outcome", "separation_low_deg"),
    ),
    Table(
        "imprint_density",
        "a bin of local density (`survey-sim imprint`)",
        (
            SCENARIO,
            PROGRAMME_NAME,
            OUTCOME,
            Column("density_per_sq_deg", FLOAT, "deg-2", "src.density", "mean of the bin: targets of the survey around"),
            N,
            FRAC,
            FRAC_ERROR,
        ),
        key=("scenario", "programme", "outcome", "density_per_sq_deg"),
        order=("scenario", "programme", "outcome", "density_per_sq_deg"),
    ),
    Table(
        "imprint_plate",
        "a square of the plate (`survey-sim imprint`)",
        (
            SCENARIO,
            PROGRAMME_NAME,
            OUTCOME,
            Column("x_mm", FLOAT, "mm", "pos.cartesian.x;instr.det", "its middle, plate x (east)"),
            Column("y_mm", FLOAT, "mm", "pos.cartesian.y;instr.det", "its middle, plate y (north)"),
            N,
            FRAC,
            FRAC_ERROR,
        ),
        key=("scenario", "programme", "outcome", "x_mm", "y_mm"),
        order=("scenario", "programme", "outcome", "x_mm", "y_mm"),
    ),
    Table(
        "imprint_park",
        "a bin of distance from the nearest robot's park (`survey-sim imprint`)",
        (
            SCENARIO,
            PROGRAMME_NAME,
            OUTCOME,
            Column("park_distance_mm", FLOAT, "mm", "phys.size;instr", "mean distance from the nearest live robot's park"),
            N,
            FRAC,
            FRAC_ERROR,
        ),
        key=("scenario", "programme", "outcome", "park_distance_mm"),
        order=("scenario", "programme", "outcome", "park_distance_mm"),
    ),
    Table(
        "bitweights",
        "a science target in many realisations of its allocation (`survey-sim weights`, docs/imprint.md)",
        (
            TARGET_ID,
            SURVEY,
            PROGRAMME_NAME,
            _count("n_realisation", "realisations of the allocation"),
            Column("probability_frac", FLOAT, "", "stat.probability", "share of them that complete the target"),
        ),
        key=("target_id",),
        order=("target_id",),
        prefixes=(
            Column(
                "bits_",
                INT64,
                "",
                "meta.code",
                "realisation r completes the target if bit r mod 64 (0: the least) of column r div 64 is set",
            ),
        ),
    ),
)

STUDY_TABLES: Mapping[str, Table] = {table.name: table for table in _STUDY_TABLES}
ALL_TABLES: Mapping[str, Table] = {**TABLES, **STUDY_TABLES}
