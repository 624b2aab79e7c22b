"""The level that a radio map expects of each transmitter at a place."""

import numpy as np

from app.core.fingerprint.radio_map import RadioMap

KERNEL_M = 3.0
"""About the length over which shadowing stays alike, and how far survey scans lie apart."""

REACH_M = 3.0 * KERNEL_M
"""Fingerprints farther away say nothing of a place: their weight is below 1 %."""


def levels_near(radio_map: RadioMap, floor_index: int, x_m: float, y_m: float) -> dict[str, float]:
    """Return the expected level, dBm, by transmitter key; what nobody heard near is left out.

    u_t = Σ_r w_r u_rt / Σ_r w_r over the fingerprints r of the floor within `REACH_M` that have
    transmitter t, w_r = exp(-d_r² / (2 h²)) of their distance d_r (Nadaraya 1964, Watson 1964).
    """
    distance2 = (radio_map.x_m - x_m) ** 2 + (radio_map.y_m - y_m) ** 2
    near = (radio_map.floor_index == floor_index) & (distance2 <= REACH_M**2)
    weight = np.where(near, np.exp(-0.5 * distance2 / KERNEL_M**2), 0.0)
    of_entry = np.repeat(weight, np.diff(radio_map.row_start))
    columns = len(radio_map.transmitters)
    total = np.bincount(radio_map.column, of_entry, columns)
    levels = np.bincount(radio_map.column, of_entry * radio_map.rssi_dbm, columns)
    return {radio_map.transmitters[i]: float(levels[i] / total[i]) for i in np.flatnonzero(total)}
