"""What each exchange file holds: its PARAMs, its TABLEs and their columns, with unit, UCD and meaning.

Columns that a run's tables have too are those of `schema.py`, so one quantity has one name everywhere. Goodwin et al. 2014:
Figure 6 (files between catalogue, allocator, router and simulator), Figure 11 (the router's four tables).
"""

from dataclasses import dataclass, replace

from survey_sim.schema import FLOAT, INT32, PATHS, TABLES, TEXT, Column


@dataclass(frozen=True)
class TableModel:
    """One TABLE of a file.

    Attributes
    ----------
    row
        What a row is.
    optional
        Columns that a file from elsewhere may leave out.
    """

    name: str
    row: str
    columns: tuple[Column, ...]
    optional: frozenset[str] = frozenset()


@dataclass(frozen=True)
class FileModel:
    """One kind of file: a RESOURCE with its name, PARAMs (all optional when read) and TABLEs (all needed)."""

    name: str
    description: str
    params: tuple[Column, ...]
    tables: tuple[TableModel, ...]


def _of(table: str, *names: str) -> tuple[Column, ...]:
    columns = TABLES[table].columns
    return tuple(column for name in names for column in columns if column.name == name)


def _text(name: str, ucd: str, description: str) -> Column:
    return Column(name, TEXT, "", ucd, description)


def _number(name: str, unit: str, ucd: str, description: str) -> Column:
    return Column(name, FLOAT, unit, ucd, description)


_PLATE_PARAMS = (
    _text("instrument", "meta.id;instr", "name of the instrument"),
    _number("plate_radius_mm", "mm", "phys.size.radius;instr", "radius of the field plate"),
    _number("plate_scale_arcsec_mm", "arcsec/mm", "instr.scale", "plate scale, equidistant projection"),
)
_ROBOT_PARAMS = (
    _number("patrol_radius_mm", "mm", "phys.size.radius;instr", "reach of a science robot from its park position"),
    _number("guide_patrol_radius_mm", "mm", "phys.size.radius;instr", "reach of a guide robot from its park position"),
    _number("min_separation_mm", "mm", "pos.distance;stat.min", "least distance between the centres of two robots"),
    _number("robot_diameter_mm", "mm", "phys.size.diameter;instr", "outer diameter of a robot"),
    _number("coarse_speed_mm_s", "mm/s", "phys.veloc;instr", "coarse positioning: speed"),
    _number("coarse_step_mm", "mm", "phys.size;instr", "coarse positioning: step"),
    _number("precise_speed_mm_s", "mm/s", "phys.veloc;instr", "precise positioning: speed"),
    _number("precise_step_mm", "mm", "phys.size;instr", "precise positioning: step"),
    _number("rotation_speed_deg_s", "deg/s", "phys.veloc.rotat;instr", "speed of rotation"),
    _number("rotation_step_deg", "deg", "pos.posAng;instr", "step of rotation"),
    _number("precise_approach_mm", "mm", "phys.size;instr", "last part of every robot's way, gone at the precise speed"),
)
INSTRUMENT_PARAMS = (*_PLATE_PARAMS, *_ROBOT_PARAMS)

_FIELD_PARAMS = (
    *_of("visits", "survey", "tile_id"),
    _number("centre_ra_deg", "deg", "pos.eq.ra;obs.field", "right ascension of the field centre, ICRS"),
    _number("centre_dec_deg", "deg", "pos.eq.dec;obs.field", "declination of the field centre, ICRS"),
)
MINIMA_PARAMS = tuple(
    Column(name, INT32, "", "meta.number;stat.min", description)
    for name, description in (
        ("min_standard", "least acceptable number of standard stars"),
        ("min_sky", "least acceptable number of sky positions"),
        ("min_guide", "least acceptable number of guide stars"),
        ("min_sky_region", "least acceptable number of sky positions in each sector of the plate"),
        ("sky_regions", "equal sectors of the plate, counted from +x towards +y"),
    )
)
_VISIT_PARAMS = (
    *_FIELD_PARAMS,
    *_of("visits", "visit_id"),
    _text("algorithm", "meta.id;meta.software", "allocation algorithm"),
    _number("travel_power", "", "arith", "cost of a move of d mm is d^travel_power"),
    _text("start", "meta.code", "where start_to_target begins: previous (the initial positions) or park"),
    *MINIMA_PARAMS,
)

_ID = _of("robots", "robot_id")
_ROBOT_KIND = replace(_of("robots", "kind")[0], name="robot_kind", description="kind of the robot: science or guide")
_STATE = _of("robots", "state")
_PARK = _of("robots", "park_x_mm", "park_y_mm")
_PATROL = _of("robots", "patrol_radius_mm")
ROBOT_COLUMNS = (_ROBOT_KIND, *_STATE, *_PARK, *_PATROL)
_ROBOT_NAMES = frozenset(column.name for column in ROBOT_COLUMNS)
_HELD = _of("allocations", "target_id", "kind")
_PLACE = _of("allocations", "x_mm", "y_mm")
_STAND = tuple(
    replace(column, description=f"plate {axis} of the robot's centre where it stands")
    for column, axis in zip(_PLACE, ("x (east)", "y (north)"), strict=True)
)
_THETA = replace(_of("legs", "theta_deg")[0], description="orientation in which it stands, in [-180, 180)")

_TARGETS = TableModel(
    "targets",
    "a target of the field",
    (
        *_of("targets", "target_id", "kind", "source_id"),
        *(replace(column, is_nullable=True) for column in _of("targets", "ra_deg", "dec_deg")),
        *(
            replace(column, description=f"plate {axis} of the target")
            for column, axis in zip(_PLACE, ("x (east)", "y (north)"), strict=True)
        ),
        *_of("targets", "mag", "priority", "wanted_visits"),
    ),
    optional=frozenset({"kind", "source_id", "ra_deg", "dec_deg", "x_mm", "y_mm", "mag", "priority", "wanted_visits"}),
)

_ALLOCATION = TableModel(
    "allocation",
    "a robot, and where it goes",
    (*_ID, *ROBOT_COLUMNS, *_HELD, *_PLACE, *_of("allocations", "travel_mm")),
    optional=_ROBOT_NAMES | {"target_id", "kind", "travel_mm"},
)

_REASONS = tuple(
    _text(f"reason_{path}", "meta.code.error", f"why it was not routed on {path}; null: it was") for path in PATHS
)
_INITIAL = TableModel(
    "initial_positions",
    "a robot, and where it stands before the visit",
    (*_ID, *ROBOT_COLUMNS, *_HELD, *_STAND, _THETA, *(replace(column, is_nullable=True) for column in _REASONS)),
    optional=_ROBOT_NAMES | {"target_id", "kind", *(column.name for column in _REASONS)},
)

_MOVES = (
    Column("tick", INT32, "", "meta.number", "synchronous set of moves, from 0; the next begins when all have ended"),
    *_ID,
    *_of("legs", "x_mm", "y_mm", "theta_deg"),
    *_of("legs", "dx_mm", "dy_mm"),
    replace(_of("legs", "rotate_deg")[0], name="dtheta_deg"),
    *_of("legs", "precise_mm"),
    replace(_of("legs", "start_s")[0], description="when the tick begins, from the start of the path"),
    replace(_of("legs", "leg")[0], description="leg of the robot that the move is a part of, from 0"),
)


def _moves(path: str) -> TableModel:
    begin, end = path.split("_to_")
    row = f"a move of a robot in a tick, on its way from {begin} to {end}"
    return TableModel(path, row, _MOVES, optional=frozenset({"precise_mm", "start_s", "leg"}))


SYSTEM_PARAMETERS = FileModel(
    "system_parameters",
    "System parameters: the field plate and the park positions.",
    _PLATE_PARAMS,
    (TableModel("park_positions", "a robot", (*_ID, _ROBOT_KIND, *_STATE, *_PARK)),),
)
STARBUGS = FileModel(
    "starbugs",
    "Starbug data: reach, separation, speeds and steps of the robots.",
    (_PLATE_PARAMS[0], *_ROBOT_PARAMS),
    (TableModel("starbugs", "a robot", (*_ID, _ROBOT_KIND, *_STATE, *_PATROL)),),
)
CATALOGUE = FileModel("catalogue", "Science catalogue of one field.", (*_FIELD_PARAMS, *_PLATE_PARAMS), (_TARGETS,))
ALLOCATION = FileModel(
    "allocation",
    "Allocation of one visit: where every robot goes.",
    (*_VISIT_PARAMS, *INSTRUMENT_PARAMS),
    (_ALLOCATION,),
)
ROUTER = FileModel(
    "router",
    "Routes of one visit: the initial positions, and the moves of its three paths.",
    (*_VISIT_PARAMS, _text("router", "meta.id;meta.software", "routing algorithm"), *INSTRUMENT_PARAMS),
    (_INITIAL, *(_moves(path) for path in PATHS)),
)
POSITIONS = FileModel(
    "positions",
    "Backup of the robots' current positions.",
    (*_FIELD_PARAMS[:2], *INSTRUMENT_PARAMS),
    (
        TableModel(
            "positions",
            "a robot, and where it stands",
            (*_ID, *ROBOT_COLUMNS, *_STAND, _THETA),
            optional=_ROBOT_NAMES,
        ),
    ),
)
FILES = {model.name: model for model in (SYSTEM_PARAMETERS, STARBUGS, CATALOGUE, ALLOCATION, ROUTER, POSITIONS)}

# Other names of a column in files that follow the paper's wording.
ALIASES = {
    "bug": "robot_id",
    "bug_id": "robot_id",
    "starbug": "robot_id",
    "robot": "robot_id",
    "ra": "ra_deg",
    "dec": "dec_deg",
}
