"""The independent proof behind `survey-sim check`: everything a run claims, derived again from its tables alone.

It shares no code with what made the tables (allocation, routing, simulation, geometry, motion): of the package it uses the
declaration of the tables, their reader, and the errors. Each check has a name, which its faults carry:

schema
    Columns, types, nulls, codes, ranges and keys are as declared; rows refer to rows that exist; visits of a tile count
    from 0; every visit has its three paths, a row of `allocations` for each robot and of `robot_times` for each robot and
    path.
starts
    A path's first legs begin where they should: `start_to_target` where the last visit's ended (its `x_mm`, `y_mm`, and
    the theta of its last leg), or at park with theta 0 if it is the first or `visits.start` is park; `start_to_park`
    where the last visit's `start_to_target` ended, whatever `visits.start` is; `park_to_target` at park with theta 0. In a
    single field whose run.json has `start_positions`, these stand for park and theta 0 as what the first visit finds.
legs
    Legs count from 0, none begins before the last has ended, each ends where turn and travel lead; it turns by 45 deg at
    most and goes along one axis, or does not turn and goes along x, then y; the last leg of a path, and no other, ends
    with the precise approach (the whole leg where that is shorter); theta is in [-180, 180).
ends
    `start_to_target` and `park_to_target` end at the allocation, `start_to_park` at park, unless `robot_times.reason`
    says that the robot was not routed: then it has no leg, and on `start_to_target` its allocation is its start, with no
    target. Dead robots have no leg and stay where they are on every path; none counts as unrouted.
reach
    Ends and corners of legs and all resting places of live robots lie in the patrol disc and on the plate; so every
    place between does.
targets
    A robot with a target stands where it projects (equidistant, within 1 um); kinds agree; guide robots hold guide stars,
    and no other robot does; a target has one robot a visit, in its own survey and home tile; a science target is held in
    at most `wanted_visits` visits; dead robots hold none. `unallocated` lists the science
    targets of all tiles that are held in fewer, and in how many.
separation
    No two robots come nearer than `min_separation_mm` (tolerance 1e-6 mm) at any instant of a path, in closed form from
    the legs; `paths.min_separation_mm` (inf for a plate of one robot) and `collisions` (pairs nearer than that) agree. In
    `executions` (with errors of execution, which nobody can derive again) no more pairs touch than are nearer than that.
times
    The configuration time is when the last robot comes to rest; the 95 % one is the k-th smallest rest time of the n
    robots that have legs, k = ceil(0.95 n); the median is that of the same times; all 0 where none moves. The lower bound
    is the longest time that a live, routed robot whose path ends elsewhere than it begins would need alone: the quicker
    of turning onto the line and going x then y, precise approach included, whether or not the corner is in reach. Ticks
    are the distinct `start_s` of the path's legs. `unrouted` counts live robots with a reason. A robot waits from 0 until
    it comes to rest for good, less what it turns and goes. Times of `executions` add up.
visits
    Counts are of rows by `kind`; idle are live robots without target; `travel_mm` is the straight distance from where
    `start_to_target` begins, its mean, 95 % rank (as above) and maximum those of the robots with travel > 0, else 0;
    crossings are pairs of those straight lines that properly intersect; magnitudes are the extremes of the science
    targets held; completeness is science targets at home in the tile that have all wanted visits in it / all such, 1.0
    for a tile without; it does not exceed its proven bound; figures that `paths` holds too are the same.
tiles
    `n_target` counts the science targets at home in the tile.
exposures
    Pointings count from 0; between two open shutters there is time for the exposure and, within a night, for the longest of
    slew, readout and configuration. `configuration_time_s` is that of the pointing's own path in `exposure_paths`; or always
    the constant of the schedule's settings, and then robots are not followed.
exposure_paths, exposure_allocations, exposure_legs
    What the plate really did, under the same checks as the paths of visits (starts, legs, ends, reach, targets, separation,
    times): each pointing's path begins where the night's last pointing left the robots, the first at park with theta 0;
    its targets, held and missed, are those of its visit; `theta_deg` is that of the last leg; what is missed has a reason.
    All pointings of a night are in one part.
nights
    A pointing is within a day of its night's `evening_mjd`; pointings, overheads and open-shutter seconds add up, to no more
    than the clear time; the completeness
    of each programme is science targets with all wanted visits observed by then / all. Where targets may fail
    (`schedule.success_frac` below 1), that is its upper bound, it never falls, and it ends as `target_status` does.
time_budget, completeness
    Time of each activity by year, pointing by pointing: up to the end of the readout it is reading, then slewing, then
    configuring, then calibrating. Targets and complete ones of each bin are counted again, and the bins of each quantity
    hold every target once.
target_status
    A row for each science target: `n_observed` pointings with status observed at which a robot holds it, their first and
    last night, and a reason just where fewer than wanted; upper bounds where targets may fail. In a run without
    `exposures`, every visit counts as observed, in no night.
"""

from survey_sim.check.faults import CheckResult, Fault
from survey_sim.check.run import check_run

__all__ = ["CheckResult", "Fault", "check_run"]
