"""Two levels at once: readings of one key that come from two transmitters.

Equation
--------
The n readings of an anchor in a window, in order of level, are parted where that takes the most
from their squared deviations, ``G = SS - SS_low - SS_high``. For two transmitters of one key whose
levels are anywhere in the span S, against one, with the readings' noise s::

    B = G / (2 s^2) - n ln 2 - ln(S sqrt(n_small) / (sqrt(2 pi) s))

(each reading may be of either; the second level is known to ``s / sqrt(n_small)`` once it is
heard). ``s^2`` is the median over the window's anchors of each one's variance, so that a phone or a
hall whose levels flutter blames nobody. The lowest reading is left away, each part has two or more
of the others, and in time they alternate: one deep fade is none, nor is a level that steps once
because a corner was turned.

Sources: Bayes factor of a mixture of two normals with known variance; Fisher, "On grouping for
maximum homogeneity", JASA 53, 1958 (the parting).
"""

import numpy as np
from numba import njit

from app.core.lateration.posterior import SPAN_DB
from app.core.radio.windows import Window
from app.core.types import FloatArray, IntArray

LEAST_READINGS, LEAST_PART, LEAST_RUNS = 5, 2, 3

LEAST_NOISE_DB = 3.0
"""Fading, averaged over what a receiver averages, is rarely less."""

MOST = 6.0
"""No window says more, since fading is not normal: one alone names nobody."""


def two_levels(window: Window, anchors: int) -> FloatArray:
    """Return ln of how much likelier two transmitters make each anchor's readings, (anchors,).

    At least 0: two that are as loud as each other look like one, and of two one is often not heard.

    Parameters
    ----------
    window
        Readings of ``anchors`` different anchors, sorted by anchor, then time.
    """
    return _told(window.anchor_index, window.rssi_dbm, anchors)


@njit(cache=True)
def _told(
    anchor_index: IntArray, rssi_dbm: FloatArray, anchors: int
) -> FloatArray:  # pragma: no cover - compiled
    border = np.zeros(anchors + 1, dtype=np.int64)
    i = 0
    for k in range(1, len(anchor_index)):
        if anchor_index[k] != anchor_index[k - 1]:
            i += 1
            border[i] = k
    border[anchors] = len(anchor_index)
    gain_db2, variance_db2, part = _parted(rssi_dbm, border)
    noise_db2 = LEAST_NOISE_DB**2
    known_db2 = variance_db2[variance_db2 >= 0.0]
    if len(known_db2):
        noise_db2 = max(np.median(known_db2), noise_db2)
    told = np.zeros(anchors)
    for i in range(anchors):
        if part[i] > 0:
            span = SPAN_DB * np.sqrt(part[i] / (2.0 * np.pi * noise_db2))
            bayes = 0.5 * gain_db2[i] / noise_db2 - np.log(span)
            bayes -= (border[i + 1] - border[i]) * np.log(2.0)
            told[i] = min(max(bayes, 0.0), MOST)
    return told


@njit(cache=True)
def _runs(level_dbm: FloatArray, threshold_dbm: float) -> int:  # pragma: no cover - compiled
    """Return how often levels in time change sides, and one; the lowest does not count."""
    deepest = np.argmin(level_dbm)
    runs, before = 0, -1
    for k in range(len(level_dbm)):
        louder = 1 if level_dbm[k] > threshold_dbm else 0
        if k != deepest and louder != before:
            runs, before = runs + 1, louder
    return runs


@njit(cache=True)
def _parted(
    rssi_dbm: FloatArray, border: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:  # pragma: no cover - compiled
    """Return per anchor the gain of parting its readings, their variance, and the smaller part.

    The part is 0 where readings are too few or do not alternate; the variance -1 for one reading.
    """
    anchors = len(border) - 1
    gain_db2, variance_db2 = np.zeros(anchors), np.full(anchors, -1.0)
    part = np.zeros(anchors, dtype=np.int64)
    for i in range(anchors):
        level = rssi_dbm[border[i] : border[i + 1]]
        count = len(level)
        if count > 1:
            variance_db2[i] = level.var() * count / (count - 1)
        if count < LEAST_READINGS:
            continue
        ordered = np.sort(level)[1:]
        total, low, threshold = ordered.sum(), 0.0, 0.0
        for k in range(1, count - LEAST_PART):
            low += ordered[k - 1]
            apart_db = (total - low) / (count - 1 - k) - low / k
            gain = k * (count - 1 - k) / (count - 1) * apart_db * apart_db
            if k >= LEAST_PART and gain > gain_db2[i]:
                gain_db2[i], part[i] = gain, min(k, count - 1 - k)
                threshold = 0.5 * (ordered[k - 1] + ordered[k])
        if _runs(level, threshold) < LEAST_RUNS:
            part[i] = 0
    return gain_db2, variance_db2, part
