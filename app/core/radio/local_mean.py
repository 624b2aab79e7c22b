"""The local mean: what many readings of one transmitter at one place amount to.

Equation
--------
``u = 10 log10(mean 10^(u_j / 10))``: the mean of the received powers, not of the decibels. Around a
place the paths' interference lets the level fade, deeply and for a moment downwards, little upwards
(Rayleigh: 18 dB below the mean power in 1 % of cases, 6.6 dB above), so the decibel mean of a few
readings is low and scatters, and depends on which fades were too weak to be heard at all; the power
hardly notices them.

Source: Rappaport, Wireless Communications, 2nd ed. 2002, ch. 4 (the local mean is one of power).
"""

import numpy as np

from app.core.types import FloatArray, IntArray

DB_PER_NEPER = 10.0 / np.log(10.0)


def local_means_dbm(group: IntArray, rssi_dbm: FloatArray, groups: int) -> FloatArray:
    """Return the mean power of each group's readings.

    Parameters
    ----------
    group : (readings,)
        Of each reading, 0 to ``groups - 1``.
    rssi_dbm : (readings,)
        Levels.

    Returns
    -------
    (groups,)
        Levels, dBm; -inf for a group without readings.
    """
    power = np.bincount(group, np.exp(rssi_dbm / DB_PER_NEPER), groups)
    count = np.maximum(np.bincount(group, minlength=groups), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(DB_PER_NEPER * np.log(power / count))
