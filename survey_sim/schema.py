"""Every table of a run: one declaration of name, type, unit, UCD and description a column.

Writers, readers, VOParquet metadata and the docs page of the data model are all made from `TABLES`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import polars as pl

SCHEMA_VERSION = 1

# The three routes of a visit (the paper's tables 1, 2, 3).
PATHS = ("start_to_target", "start_to_park", "park_to_target")
TARGET_KINDS = ("science", "standard", "sky", "guide")

INT8, INT16, INT32, INT64 = pl.Int8(), pl.Int16(), pl.Int32(), pl.Int64()
FLOAT, TEXT, BOOL = pl.Float64(), pl.String(), pl.Boolean()


@dataclass(frozen=True)
class Column:
    """One column: its name, polars type, unit (VOUnit syntax; "" = none), UCD, and meaning."""

    name: str
    dtype: pl.DataType
    unit: str
    ucd: str
    description: str
    is_nullable: bool = False


@dataclass(frozen=True)
class Table:
    """One table: what a row is, its columns, the columns that name a row, and how it is stored.

    Attributes
    ----------
    key
        Columns that name a row; no two rows share them.
    order
        Columns by which rows are sorted in a file.
    is_in_parts
        Stored as a folder of parts, a part for each batch of tiles, rather than as one file.
    prefixes
        Columns made per programme: a column that starts with the prefix is declared by it.
    """

    name: str
    row: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    order: tuple[str, ...]
    is_in_parts: bool = False
    prefixes: tuple[Column, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the declared columns, in order."""
        return [column.name for column in self.columns]

    def column(self, name: str) -> Column | None:
        """Declaration of a column, by its name or its prefix; None if there is none."""
        for column in self.columns:
            if column.name == name:
                return column
        for column in self.prefixes:
            if name.startswith(column.name):
                return Column(name, column.dtype, column.unit, column.ucd, column.description, column.is_nullable)
        return None


# Columns that several tables share.
SURVEY = Column("survey", TEXT, "", "meta.id;meta.main", "survey that the row belongs to (taipan, funnelweb, ...)")
PROGRAMME = Column("programme", TEXT, "", "meta.id;obs.proposal", "science case; null for sky, guides, standards", True)
TILE_ID = Column("tile_id", INT32, "", "meta.id;obs.field", "pointing, counted from 0 in each survey")
VISIT_ID = Column("visit_id", INT16, "", "meta.id;obs", "configuration of the tile, counted from 0")
ROBOT_ID = Column("robot_id", INT32, "", "meta.id;instr", "robot, counted from 1, science robots first")
TARGET_ID = Column("target_id", INT64, "", "meta.id;src", "target: its place in the sorted target list of the run")
TARGET_KIND = Column("kind", TEXT, "", "meta.code.class", "what the target is for: science, standard, sky, guide")
PATH = Column("path", TEXT, "", "meta.code", "route: start_to_target, start_to_park, park_to_target")
RA = Column("ra_deg", FLOAT, "deg", "pos.eq.ra;meta.main", "right ascension, ICRS")
DEC = Column("dec_deg", FLOAT, "deg", "pos.eq.dec;meta.main", "declination, ICRS")
MAG = Column("mag", FLOAT, "mag", "phot.mag;em.opt", "magnitude in the catalogue's own band; null for sky", True)
SOURCE_ID = Column("source_id", TEXT, "", "meta.id;meta.dataset", "identifier in the catalogue it came from")
X = Column("x_mm", FLOAT, "mm", "pos.cartesian.x;instr.det", "plate x (east) of the robot's centre where it ends")
Y = Column("y_mm", FLOAT, "mm", "pos.cartesian.y;instr.det", "plate y (north) of the robot's centre where it ends")
_EXPOSURE_ID = Column("exposure_id", INT32, "", "meta.id;obs", "pointing, counted from 0 in time")
NIGHT = Column("night", INT32, "d", "time.epoch;obs", "night, counted from 0 at the schedule's first evening")

_CONFIGURATION = (
    Column("configuration_time_s", FLOAT, "s", "time.duration;stat.max", "when the last robot of the path comes to rest"),
    Column("configuration_time_p95_s", FLOAT, "s", "time.duration", "when 95 % of the moving robots have come to rest"),
)
_MEDIAN = Column("configuration_time_median_s", FLOAT, "s", "time.duration;stat.median", "median rest time of moving robots")
_LOWER_BOUND = Column("lower_bound_s", FLOAT, "s", "time.duration;stat.min", "the slowest single robot, were it alone")
_TICKS = Column("ticks", INT32, "", "meta.number", "synchronous moves that the path is cut into")
_COLLISIONS = Column("collisions", INT32, "", "meta.number", "pairs of robots nearer than the separation at some time")
_UNROUTED = Column("unrouted", INT32, "", "meta.number", "robots that the router had to leave where they stood")
_LEAST_SEPARATION = Column(
    "min_separation_mm", FLOAT, "mm", "pos.distance;stat.min", "least distance between two robots at any instant"
)
# What a leg is, and the state that it ends in.
_LEG = (
    Column("leg", INT16, "", "meta.number", "leg of the robot on this path, counted from 0"),
    Column("start_s", FLOAT, "s", "time.duration", "when it begins, from the start of the path"),
    Column("rotate_deg", FLOAT, "deg", "pos.posAng;instr", "turn in place first, counter-clockwise"),
    Column("dx_mm", FLOAT, "mm", "pos.cartesian.x;instr", "then go along the robot's own x axis"),
    Column("dy_mm", FLOAT, "mm", "pos.cartesian.y;instr", "then go along the robot's own y axis"),
    Column("precise_mm", FLOAT, "mm", "phys.size;instr", "last part of the travel, gone at the precise speed"),
    X,
    Y,
    Column("theta_deg", FLOAT, "deg", "pos.posAng;instr", "orientation in which the leg ends, in [-180, 180)"),
)


def _count(name: str, what: str, *, is_nullable: bool = False) -> Column:
    return Column(name, INT32, "", "meta.number", what, is_nullable)


def _shortfall(name: str, what: str) -> Column:
    return _count(f"{name}_shortfall", f"{what} fewer than the least acceptable; null: that is not known", is_nullable=True)


def _once_routed(column: Column) -> Column:
    return replace(column, description=f"{column.description}; null: not routed yet", is_nullable=True)


def _frac(name: str, what: str, *, is_nullable: bool = False) -> Column:
    return Column(name, FLOAT, "", "stat.value", what, is_nullable)


_VISIT_KEY = ("survey", "tile_id", "visit_id")

_TABLES = (
    Table(
        "robots",
        "a robot",
        (
            SURVEY,
            ROBOT_ID,
            Column("kind", TEXT, "", "meta.code.class;instr", "science or guide"),
            Column("state", TEXT, "", "meta.code.status;instr", "live, or dead (never moves)"),
            Column("park_x_mm", FLOAT, "mm", "pos.cartesian.x;instr.det", "plate x (east) of the park position"),
            Column("park_y_mm", FLOAT, "mm", "pos.cartesian.y;instr.det", "plate y (north) of the park position"),
            Column("patrol_radius_mm", FLOAT, "mm", "phys.size.radius;instr", "reach from park"),
        ),
        key=("survey", "robot_id"),
        order=("survey", "robot_id"),
    ),
    Table(
        "targets",
        "a target",
        (
            TARGET_ID,
            SURVEY,
            PROGRAMME,
            TARGET_KIND,
            SOURCE_ID,
            RA,
            DEC,
            MAG,
            Column("priority", INT8, "", "meta.code", "1 (low) to 9 (high)"),
            Column("wanted_visits", INT16, "", "meta.number;obs", "visits a science target wants; 0: usable at any visit"),
            Column(
                "tile_id",
                INT32,
                "",
                "meta.id;obs.field",
                "home tile of a science target; null: any tile may use it",
                True,
            ),
            Column("_healpix_29", INT64, "", "pos.healpix", "HEALPix cell, nested, order 29 (the HATS column)"),
        ),
        key=("target_id",),
        order=("_healpix_29", "target_id"),
    ),
    Table(
        "rejected",
        "a catalogue row not used",
        (
            Column("catalogue", TEXT, "", "meta.id;meta.table", "name of the catalogue's card"),
            SURVEY,
            SOURCE_ID,
            Column("ra_deg", FLOAT, "deg", "pos.eq.ra", "right ascension as read, ICRS", True),
            Column("dec_deg", FLOAT, "deg", "pos.eq.dec", "declination as read, ICRS", True),
            MAG,
            Column("reason", TEXT, "", "meta.code.error", "why the row is not a target"),
            Column(
                "other_source_id",
                TEXT,
                "",
                "meta.id;meta.dataset",
                "for too-close-pair: the target that stands for it",
                True,
            ),
        ),
        key=("catalogue", "survey", "source_id", "reason"),
        order=("catalogue", "survey", "source_id", "reason"),
    ),
    Table(
        "tiles",
        "a tile",
        (SURVEY, TILE_ID, RA, DEC, _count("n_target", "science targets whose home the tile is")),
        key=("survey", "tile_id"),
        order=("survey", "tile_id"),
    ),
    Table(
        "visits",
        "a visit",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            Column("start", TEXT, "", "meta.code", "where start_to_target begins: previous (visit's end) or park"),
            Column("mag_bright", FLOAT, "mag", "phot.mag;stat.min", "brightest science target observed", True),
            Column("mag_faint", FLOAT, "mag", "phot.mag;stat.max", "faintest science target observed", True),
            _count("n_science", "robots that reached a science target"),
            _count("n_standard", "robots that reached a standard star"),
            _count("n_sky", "robots that reached a sky position"),
            _count("n_guide", "guide robots that reached a guide star"),
            _count("n_idle", "live robots with no target"),
            _shortfall("standard", "standard stars"),
            _shortfall("sky", "sky positions"),
            _shortfall("guide", "guide stars"),
            _shortfall("sky_region", "sky positions, summed over equal sectors of the plate,"),
            _frac("completeness_frac", "science targets of the tile with all wanted visits, after this visit"),
            _frac("ideal_completeness_frac", "the same for an ideal positioner (no separation, unbounded reach)"),
            _frac(
                "completeness_bound_frac",
                "proven upper bound of it for any allocation; null: not computed",
                is_nullable=True,
            ),
            Column("travel_mean_mm", FLOAT, "mm", "phys.size;stat.mean", "mean straight distance of robots that travel"),
            Column("travel_p95_mm", FLOAT, "mm", "phys.size", "95 % of the robots that travel go no further"),
            Column("travel_max_mm", FLOAT, "mm", "phys.size;stat.max", "largest straight distance"),
            _count("crossings", "pairs of straight segments, start to target, that intersect"),
            *(_once_routed(column) for column in (_COLLISIONS, _UNROUTED, _TICKS, *_CONFIGURATION, _LOWER_BOUND)),
        ),
        key=_VISIT_KEY,
        order=_VISIT_KEY,
    ),
    Table(
        "allocations",
        "a robot in a visit",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            ROBOT_ID,
            Column("target_id", INT64, "", "meta.id;src", "target that the robot holds; null if idle", True),
            Column("kind", TEXT, "", "meta.code.class", "kind of that target; null if idle", True),
            X,
            Y,
            Column("travel_mm", FLOAT, "mm", "phys.size", "straight distance from where start_to_target begins"),
        ),
        key=(*_VISIT_KEY, "robot_id"),
        order=(*_VISIT_KEY, "robot_id"),
        is_in_parts=True,
    ),
    Table(
        "paths",
        "a path of a visit",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            PATH,
            *_CONFIGURATION,
            _MEDIAN,
            _LOWER_BOUND,
            _TICKS,
            _COLLISIONS,
            _UNROUTED,
            _LEAST_SEPARATION,
        ),
        key=(*_VISIT_KEY, "path"),
        order=(*_VISIT_KEY, "path"),
    ),
    Table(
        "legs",
        "a leg",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            PATH,
            ROBOT_ID,
            *_LEG,
        ),
        key=(*_VISIT_KEY, "path", "robot_id", "leg"),
        order=(*_VISIT_KEY, "path", "robot_id", "leg"),
        is_in_parts=True,
    ),
    Table(
        "robot_times",
        "a robot on a path",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            PATH,
            ROBOT_ID,
            Column("rotating_s", FLOAT, "s", "time.duration", "time spent turning"),
            Column("moving_s", FLOAT, "s", "time.duration", "time spent going"),
            Column("waiting_s", FLOAT, "s", "time.duration", "time spent still before it came to rest for good"),
            Column("reason", TEXT, "", "meta.code.error", "why it was not routed; null: it arrived", True),
        ),
        key=(*_VISIT_KEY, "path", "robot_id"),
        order=(*_VISIT_KEY, "path", "robot_id"),
        is_in_parts=True,
    ),
    Table(
        "executions",
        "a path of a visit played with errors of execution; none if [simulation] has no errors",
        (
            SURVEY,
            TILE_ID,
            VISIT_ID,
            PATH,
            Column("mode", TEXT, "", "meta.code", "how it was played: open-loop, resync, keep-order"),
            Column("moving_time_s", FLOAT, "s", "time.duration", "when the last robot has ended its planned legs"),
            Column("metrology_rounds", INT16, "", "meta.number", "corrections made until all are measured in tolerance"),
            Column("metrology_time_s", FLOAT, "s", "time.duration", "all measurements and corrections"),
            Column("configuration_time_s", FLOAT, "s", "time.duration;stat.max", "both times together"),
            Column(
                "min_separation_mm", FLOAT, "mm", "pos.distance;stat.min", "least distance between two robots at any instant"
            ),
            _COLLISIONS,
            Column("contacts", INT32, "", "meta.number", "pairs of robots that touch at some time"),
            Column("error_max_um", FLOAT, "um", "stat.error;stat.max", "true distance from its place of the robot furthest"),
            Column("is_within_tolerance", BOOL, "", "meta.code", "whether the last measurement found all in tolerance"),
        ),
        key=(*_VISIT_KEY, "path"),
        order=(*_VISIT_KEY, "path"),
    ),
    Table(
        "unallocated",
        "a science target that allocation did not complete",
        (
            TARGET_ID,
            SURVEY,
            TILE_ID,
            Column("n_allocated", INT16, "", "meta.number;obs", "visits in which a robot reached it"),
            Column("reason", TEXT, "", "meta.code.error", "why it did not get all its wanted visits"),
        ),
        key=("target_id",),
        order=("target_id",),
    ),
    Table(
        "exposures",
        "a pointing of the telescope",
        (
            _EXPOSURE_ID,
            NIGHT,
            Column("start_mjd", FLOAT, "d", "time.start;obs.exposure", "start of the shutter's opening, UTC, MJD"),
            SURVEY,
            TILE_ID,
            VISIT_ID,
            Column("slew_s", FLOAT, "s", "time.duration", "telescope's slew from the last pointing"),
            Column("configuration_time_s", FLOAT, "s", "time.duration", "robots' configuration for this pointing"),
            Column("readout_s", FLOAT, "s", "time.duration", "readout of the last exposure"),
            Column(
                "overhead_s",
                FLOAT,
                "s",
                "time.duration",
                "from when the telescope was free until the shutter opened, or cloud came",
            ),
            Column("exposure_s", FLOAT, "s", "time.duration;obs.exposure", "shutter open"),
            Column("airmass", FLOAT, "", "obs.airMass", "at mid-exposure"),
            Column("moon_alt_deg", FLOAT, "deg", "pos.az.alt", "altitude of the Moon at mid-exposure"),
            Column("moon_sep_deg", FLOAT, "deg", "pos.angDistance", "distance of the Moon from the field at mid-exposure"),
            Column("status", TEXT, "", "meta.code.status", "observed, or why the exposure does not count"),
        ),
        key=("exposure_id",),
        order=("exposure_id",),
    ),
    Table(
        "exposure_paths",
        "the robots' path to a pointing's configuration, from where the last pointing left them (at night's start: park)",
        (
            _EXPOSURE_ID,
            *_CONFIGURATION,
            _MEDIAN,
            _LOWER_BOUND,
            _TICKS,
            _COLLISIONS,
            _UNROUTED,
            _LEAST_SEPARATION,
        ),
        key=("exposure_id",),
        order=("exposure_id",),
    ),
    Table(
        "exposure_allocations",
        "a robot in a pointing, as it really was",
        (
            _EXPOSURE_ID,
            ROBOT_ID,
            Column("target_id", INT64, "", "meta.id;src", "target that the robot holds; null if none", True),
            Column("kind", TEXT, "", "meta.code.class", "kind of that target; null if none", True),
            X,
            Y,
            Column("theta_deg", FLOAT, "deg", "pos.posAng;instr", "orientation in which it stands, in [-180, 180)"),
            Column("travel_mm", FLOAT, "mm", "phys.size", "straight distance from where it stood"),
            Column("missed_target_id", INT64, "", "meta.id;src", "target that it should hold and did not reach", True),
            Column("reason", TEXT, "", "meta.code.error", "why it was not routed; null: it arrived", True),
        ),
        key=("exposure_id", "robot_id"),
        order=("exposure_id", "robot_id"),
        is_in_parts=True,
    ),
    Table(
        "exposure_legs",
        "a leg on the way to a pointing's configuration",
        (_EXPOSURE_ID, ROBOT_ID, *_LEG),
        key=("exposure_id", "robot_id", "leg"),
        order=("exposure_id", "robot_id", "leg"),
        is_in_parts=True,
    ),
    Table(
        "nights",
        "a night",
        (
            NIGHT,
            Column("evening_mjd", FLOAT, "d", "time.start", "local mean noon before the night, UTC, MJD"),
            Column(
                "dark_s",
                FLOAT,
                "s",
                "time.duration",
                "from the end of evening twilight to the start of morning twilight",
            ),
            Column("lost_s", FLOAT, "s", "time.duration", "of that, lost to weather"),
            Column("engineering_s", FLOAT, "s", "time.duration", "of that, clear but given to engineering"),
            Column("exposing_s", FLOAT, "s", "time.duration", "of that, with the shutter open"),
            Column(
                "overhead_s",
                FLOAT,
                "s",
                "time.duration",
                "of that, spent on slews, configuration, readout, calibration",
            ),
            _count("n_exposure", "pointings in the night"),
        ),
        key=("night",),
        order=("night",),
        prefixes=(_frac("completeness_frac_", "completeness of the programme named, after this night"),),
    ),
    Table(
        "time_budget",
        "what a year's time between twilights was spent on",
        (
            Column("year", INT16, "yr", "time.epoch", "calendar year of the evenings"),
            Column("survey", TEXT, "", "meta.id", "survey that spent it; null: none", True),
            Column(
                "activity",
                TEXT,
                "",
                "meta.code",
                "exposing, reading, slewing (beyond the readout), configuring (beyond both), calibrating; weather, "
                "engineering, idle",
            ),
            Column("time_s", FLOAT, "s", "time.duration", "time spent"),
        ),
        key=("year", "survey", "activity"),
        order=("year", "survey", "activity"),
    ),
    Table(
        "completeness",
        "a programme's targets in a bin of a quantity",
        (
            Column("programme", TEXT, "", "meta.id;obs.proposal", "science case"),
            SURVEY,
            Column(
                "quantity",
                TEXT,
                "",
                "meta.code",
                "all; year (by its end); mag (mag); priority; density (targets of the survey per square degree in a HEALPix "
                "cell of order 6); latitude (Galactic, absolute, deg)",
            ),
            Column("low", FLOAT, "", "stat.value;stat.min", "lower edge of the bin, included; null: none", True),
            Column("high", FLOAT, "", "stat.value;stat.max", "upper edge of the bin, not included; null: none", True),
            _count("n_target", "science targets of the programme in the bin"),
            _count("n_complete", "those observed in all the visits that they want"),
            _frac("completeness_frac", "n_complete / n_target"),
        ),
        key=("programme", "quantity", "low"),
        order=("programme", "quantity", "low"),
    ),
    Table(
        "target_status",
        "a science target at the end",
        (
            TARGET_ID,
            SURVEY,
            Column("programme", TEXT, "", "meta.id;obs.proposal", "science case"),
            Column("n_observed", INT16, "", "meta.number;obs", "visits observed"),
            Column("first_night", INT32, "d", "time.epoch;stat.min", "first night observed; null: never", True),
            Column("last_night", INT32, "d", "time.epoch;stat.max", "last night observed; null: never", True),
            Column("reason", TEXT, "", "meta.code.error", "why it is not complete; null: it is", True),
        ),
        key=("target_id",),
        order=("target_id",),
    ),
)

TABLES: Mapping[str, Table] = {table.name: table for table in _TABLES}
