"""Cloud over the site: a seeded random process, the same for the same nights whatever else is asked."""

from datetime import date
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from survey_sim.schedule.ephemeris import mjd_of
from survey_sim.schedule.settings import Weather

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]

# The sky is clear or cloudy for so long at a time at least, s.
STEP_S = 1_800
N_STEP_DAY = 86_400 // STEP_S
# Key of this stage among the streams of a run.
_STREAM = 1
# The process starts so many memories before the first night: what it started from is forgotten to 1 in 10^9.
_N_MEMORY_BEFORE = 20.0


def make_weather(first: date, n_night: int, settings: Weather, seed: int) -> BoolArray:
    """Whether it is cloudy, by half hours.

    A slow and a fast first-order autoregressive process of unit variance (one value a night, one a half hour) are
    added with the weights of their shares, and it is cloudy where the sum exceeds the quantile that leaves
    `mean_loss_frac` above it. So the mean is as set, whole nights are lost in runs, and clouds come and go within a
    night.

    The draws of a night come from a stream of their own, keyed by the date: the weather of a date depends on the seed and
    these settings alone, not on the first night or anything else of the schedule.

    Parameters
    ----------
    first
        Evening of the first night.
    n_night
        Number of nights.

    Returns
    -------
        (n_night, 48) from local mean noon to noon.
    """
    from scipy.special import ndtri  # noqa: PLC0415 - 0.1 s that the command line's help need not pay

    n_before = int(np.ceil(_N_MEMORY_BEFORE * max(settings.night_memory_days, settings.hour_memory_h / 24.0)))
    days = mjd_of(first) + np.arange(-n_before, n_night)
    draws = np.empty((len(days), 1 + N_STEP_DAY))
    for row, day in enumerate(days):
        stream = np.random.SeedSequence(seed, spawn_key=(_STREAM, int(day)))
        draws[row] = np.random.default_rng(stream).standard_normal(1 + N_STEP_DAY)
    share = settings.night_share_frac
    slow, fast = (_memory(1.0, settings.night_memory_days), _memory(STEP_S / 3600.0, settings.hour_memory_h))
    by_night = _autoregressive(draws[:, 0], slow)
    by_step = _autoregressive(draws[:, 1:].ravel(), fast).reshape(-1, N_STEP_DAY)
    cloud = np.sqrt(share) * by_night[:, None] + np.sqrt(1.0 - share) * by_step
    return np.asarray(cloud[n_before:] > -ndtri(settings.mean_loss_frac))


def _autoregressive(draws: FloatArray, memory: float) -> FloatArray:
    """(n,) process of unit variance driven by (n,) draws: each value is correlated with the one before it by `memory`."""
    # As scipy.signal.lfilter does it, whose import alone takes longer than a whole schedule's weather.
    steps = (np.sqrt(1.0 - memory**2) * draws).tolist()
    return np.array(list(accumulate(steps, lambda before, step: memory * before + step)))


def _memory(step: float, e_folding: float) -> float:
    """Correlation of one step to the next; 0 with no memory."""
    return float(np.exp(-step / e_folding)) if e_folding > 0 else 0.0
