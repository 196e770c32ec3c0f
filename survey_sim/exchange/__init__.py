"""Exchange files: the paper's data model as VOTables, between allocator, router, simulator and other programs.

`model` declares every file (Goodwin et al. 2014, Figures 6 and 11), `door` lets only safe XML in, `votable` turns bytes
into checked frames in our units and back, `robots` and `moves` join the frames to plates and legs,
`visits` makes whole visits of them.
"""

from survey_sim.exchange.door import N_BYTES_MAX
from survey_sim.exchange.model import (
    ALLOCATION,
    CATALOGUE,
    FILES,
    MINIMA_PARAMS,
    POSITIONS,
    ROUTER,
    STARBUGS,
    SYSTEM_PARAMETERS,
    FileModel,
    TableModel,
)
from survey_sim.exchange.moves import check_moves, legs_from_moves
from survey_sim.exchange.robots import plate_documents, plate_of, read_plate, robot_columns, robot_params, rows_of_robots
from survey_sim.exchange.visits import (
    AllocatedVisit,
    RoutedVisit,
    Standing,
    allocation_document,
    parked,
    positions_document,
    read_allocation,
    read_positions,
    read_router,
    router_document,
)
from survey_sim.exchange.votable import Document, read, read_columns, to_bytes, votable_bytes

__all__ = [
    "ALLOCATION",
    "CATALOGUE",
    "FILES",
    "MINIMA_PARAMS",
    "N_BYTES_MAX",
    "POSITIONS",
    "ROUTER",
    "STARBUGS",
    "SYSTEM_PARAMETERS",
    "AllocatedVisit",
    "Document",
    "FileModel",
    "RoutedVisit",
    "Standing",
    "TableModel",
    "allocation_document",
    "check_moves",
    "legs_from_moves",
    "parked",
    "plate_documents",
    "plate_of",
    "positions_document",
    "read",
    "read_allocation",
    "read_columns",
    "read_plate",
    "read_positions",
    "read_router",
    "robot_columns",
    "robot_params",
    "router_document",
    "rows_of_robots",
    "to_bytes",
    "votable_bytes",
]
