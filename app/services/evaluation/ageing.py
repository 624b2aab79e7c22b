"""Ageing found in traffic: identities of transmitters are permuted, and the aged ones named."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from app.core.fingerprint.ageing import AgeingParams, find_aged
from app.core.fingerprint.contradiction import Weights, learned_weights
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.single_scans import HeldOut, PlacedQuery, single_errors_m

FEW, MANY = 0.10, 0.25
"""Shares of the map's transmitters whose identities change places."""

PRECISION, RECALL, MEAN_ERROR = 0.85, 0.70, 1.05


def permuted(radio_map: RadioMap, share: float, rng: np.random.Generator) -> dict[str, str]:
    """Return new names of a share of the transmitters, each another's, of the same radio."""
    names: dict[str, str] = {}
    for kind in np.unique(radio_map.radio):
        columns = rng.permutation(np.flatnonzero(radio_map.radio == kind))
        chosen = columns[: round(share * len(columns))]
        for old, new in zip(chosen, np.roll(chosen, 1), strict=True):
            names[radio_map.transmitters[old]] = radio_map.transmitters[new]
    return names


def renamed(query: Query, names: dict[str, str]) -> Query:
    """Return what is heard where transmitters have new names."""
    return Query(
        {names.get(key, key): level for key, level in query.wifi_dbm.items()},
        {names.get(key, key): level for key, level in query.ble_dbm.items()},
    )


def ageing_figures(held: HeldOut, seeds: Sequence[int]) -> Figures:
    """Return, over seeds, how well the permuted are named and what quarantine recovers.

    ``precision`` and ``recall`` are over all of the map's transmitters, also those that traffic
    never passes; ``permuted`` and ``quarantined`` are mean errors of single fixes over the clean
    map's. ``unchanged_named`` are the transmitters named although nothing was permuted: some of
    them have truly changed between the walks.
    """
    weights = learned_weights(held.radio_map, MatchParams())
    clean_m = _mean_error_m(held.scans, held.radio_map)
    few = [_Aged.of(held, FEW, seed, weights) for seed in seeds]
    many = [_Aged.of(held, MANY, seed, weights) for seed in seeds]
    return {
        "scans": len(held.scans),
        "clean_mean_error_m": clean_m,
        "unchanged_named": len(_Aged.of(held, 0.0, 0, weights).named),
        "precision_10": over_seeds([aged.precision for aged in few], PRECISION),
        "recall_10": over_seeds([aged.recall for aged in few], RECALL),
        "precision_25": over_seeds([aged.precision for aged in many]),
        "recall_25": over_seeds([aged.recall for aged in many]),
        "permuted_25": over_seeds([aged.error_m(held.radio_map) / clean_m for aged in many]),
        "quarantined_25": over_seeds(
            [aged.error_m(aged.cleared(held.radio_map)) / clean_m for aged in many], MEAN_ERROR
        ),
    }


@dataclass(frozen=True, slots=True)
class _Aged:
    """Traffic in a building some of whose transmitters changed, and which ones were named."""

    traffic: tuple[PlacedQuery, ...]
    changed: frozenset[str]
    named: frozenset[str]

    @classmethod
    def of(cls, held: HeldOut, share: float, seed: int, weights: Weights) -> "_Aged":
        names = permuted(held.radio_map, share, np.random.default_rng(seed))
        traffic = tuple(replace(scan, query=renamed(scan.query, names)) for scan in held.scans)
        sessions = [
            [scan.query for scan in walk] for _, walk in groupby(traffic, lambda scan: scan.walk)
        ]
        found = find_aged(sessions, held.radio_map, weights, MatchParams(), AgeingParams())
        return cls(traffic, frozenset(names), frozenset(suspect.key for suspect in found))

    @property
    def precision(self) -> float:
        return len(self.named & self.changed) / len(self.named) if self.named else 0.0

    @property
    def recall(self) -> float:
        return len(self.named & self.changed) / len(self.changed)

    def cleared(self, radio_map: RadioMap) -> RadioMap:
        return radio_map.without_transmitters(self.named)

    def error_m(self, radio_map: RadioMap) -> float:
        return _mean_error_m(self.traffic, radio_map)


def _mean_error_m(scans: Sequence[PlacedQuery], radio_map: RadioMap) -> float:
    return float(np.nanmean(single_errors_m(scans, radio_map)))
