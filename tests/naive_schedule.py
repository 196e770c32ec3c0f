"""Plain-loop reference of the schedule's kernels: one night, told minute by minute, with nothing carried along."""

# ruff: noqa: PLR0912

import numpy as np

DAY_S, MINUTE_S = 86_400.0, 60.0
SIDEREAL_RAD_S = 2.0 * np.pi * 1.002737909350795 / DAY_S


def gain_of(visit, visits, targets, n_observed, weight):
    """Weighted parts of targets that a visit would gain, counted afresh."""
    total = 0.0
    for holding in range(visits.first_holding[visit], visits.first_holding[visit + 1]):
        target = visits.target[holding]
        wants = targets.wanted[target] - n_observed[target]
        if wants > 0:
            total += weight[targets.programme[target]] / wants
    return total


def configuration_time(visits, visit, previous, constant_s):
    if constant_s >= 0:
        return constant_s
    if previous == visit:
        return 0.0
    if previous >= 0 and previous + 1 == visit and visits.tile[previous] == visits.tile[visit]:
        return visits.start_to_target_s[visit]
    back_s = visits.park_to_target_s[previous] if previous >= 0 else 0.0
    return max(back_s, visits.park_to_target_s[visit])


def offered(tile, fields, visits, targets, n_observed, done, weight, repeat_min_frac):
    """Visit that a tile offers; None if none."""
    own = range(fields.first_visit[tile], fields.first_visit[tile + 1])
    ones = np.ones_like(weight)
    for visit in own:
        if visit >= done[tile] and gain_of(visit, visits, targets, n_observed, ones) > 0:
            return visit
    worth = {}
    for visit in own:
        n_held = visits.first_holding[visit + 1] - visits.first_holding[visit]
        if gain_of(visit, visits, targets, n_observed, ones) >= repeat_min_frac * n_held - 1e-9:
            worth[visit] = gain_of(visit, visits, targets, n_observed, weight)
    best = max(worth.values(), default=0.0)
    return next((visit for visit in worth if worth[visit] > best - 1e-9), None) if best > 0 else None


def levels_between(night, survey, start_s, end_s):
    return night.level[survey, int(start_s // MINUTE_S) : int(np.ceil(end_s / MINUTE_S))]


def observe_night(night, fields, visits, targets, rules):
    """(visit, start_s, slew_s, configuration_s, readout_s, exposure_s, status) of each pointing; every target succeeds."""
    n_observed = np.zeros(len(targets.target_id), dtype=int)
    done = fields.first_visit[:-1].copy()
    n_minute = len(night.is_cloudy)
    now, shut, previous, pointings = 0.0, -np.inf, -1, []
    while now < n_minute * MINUTE_S:
        if night.is_cloudy[int(now // MINUTE_S)]:
            now = (now // MINUTE_S + 1) * MINUTE_S
            continue
        sidereal = night.sidereal_rad + SIDEREAL_RAD_S * now
        hour_angle = [(sidereal - ra + np.pi) % (2 * np.pi) - np.pi for ra in fields.ra_rad]
        readout = max(0.0, shut + rules.readout_s - now)
        complete = [
            sum(n_observed[t] >= targets.wanted[t] > 0 and targets.programme[t] == p for t in range(len(n_observed)))
            for p in range(len(rules.n_enough))
        ]
        weight = np.where(np.array(complete) < rules.n_enough, 1.0, rules.beyond_wanted_weight)
        choices = []
        for tile, survey in enumerate(fields.survey):
            visit = offered(tile, fields, visits, targets, n_observed, done, weight, rules.repeat_min_frac)
            if visit is None:
                continue
            slew = 0.0
            if previous < 0 or visits.tile[previous] != tile:
                from_ha, from_dec = 0.0, rules.latitude_rad
                if previous >= 0:
                    from_ha, from_dec = hour_angle[visits.tile[previous]], fields.dec_rad[visits.tile[previous]]
                axes = abs(hour_angle[tile] - from_ha), abs(fields.dec_rad[tile] - from_dec)
                slew = max(axes) / rules.slew_rad_s + rules.settle_s
            configuration = configuration_time(visits, visit, previous, rules.configuration_s)
            start = now + max(slew, configuration, readout) + rules.calibration_s[survey]
            end = start + visits.exposure_s[visit]
            ha = [hour_angle[tile] + SIDEREAL_RAD_S * (t - now) for t in (start, (start + end) / 2, end)]
            if end > n_minute * MINUTE_S or max(abs(ha[0]), abs(ha[2])) > fields.window_rad[tile]:
                continue
            level = levels_between(night, survey, start, end).min()
            moons = night.moon[[int(start // MINUTE_S), int(np.ceil(end / MINUTE_S))]]
            if level == 0 or (moons @ fields.direction[tile] > rules.moon_cos_max[survey]).any():
                continue
            sin_alt = np.sin(rules.latitude_rad) * np.sin(fields.dec_rad[tile])
            sin_alt += np.cos(rules.latitude_rad) * np.cos(fields.dec_rad[tile]) * np.cos(ha[1])
            worth = gain_of(visit, visits, targets, n_observed, weight) * rules.survey_weight[survey]
            score = worth * fields.pressure[tile] * (fields.min_airmass[tile] * sin_alt) ** rules.airmass_power / (end - now)
            if score > 0:
                choices.append((level, score, -tile, visit, start, end, slew, configuration))
        if not choices:
            now += rules.idle_step_s
            continue
        _, _, tile, visit, start, end, slew, configuration = max(choices)
        cloudy = [m * MINUTE_S for m in range(n_minute) if night.is_cloudy[m] and now < m * MINUTE_S < end]
        stop = min([end, *cloudy])
        status = 0 if stop == end else 1 if stop > start else 2
        pointings.append((visit, start, slew, configuration, readout, max(0.0, stop - start), status))
        if status != 2:
            shut = stop
        if status == 0:
            for holding in range(visits.first_holding[visit], visits.first_holding[visit + 1]):
                n_observed[visits.target[holding]] += 1
            done[-tile] = max(done[-tile], visit + 1)
        now, previous = stop, visit
    return pointings, n_observed
