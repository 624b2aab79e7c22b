"""The one-shot question: a fresh fold over what was heard, nothing kept."""

import asyncio
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.core import engine
from app.core.engine import SessionState
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import FloatArray, IntArray, Observation, Output

ALIKE_M = 5.0
"""Candidates nearer to each other are one place: about what a single scan can tell apart."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """One place that the observations speak for, with the probability given to it."""

    floor_id: str
    x_m: float
    y_m: float
    weight: float


@dataclass(frozen=True, slots=True)
class Located:
    """The answer; ``output`` is None if there was nothing to fold."""

    output: Output | None
    alternatives: tuple[Alternative, ...]


async def locate(site: SiteModel, params: Params, observations: Iterable[Observation]) -> Located:
    """Fold observations that belong together, in event-time order, outside the event loop."""
    return await asyncio.to_thread(_fold, site, params, engine.in_order(observations))


def _fold(site: SiteModel, params: Params, ordered: Sequence[Observation]) -> Located:
    state = engine.start()
    for observation in ordered:
        state, _ = engine.advance(state, observation, site, params)
    outputs = engine.finish(state, site, params)
    return Located(outputs[-1] if outputs else None, _alternatives(state, site))


def _alternatives(state: SessionState, site: SiteModel) -> tuple[Alternative, ...]:
    """Return the places that the newest scan speaks for, the likeliest first."""
    sighting = None if state.told is None else state.told.evidence.sighting
    if sighting is None or state.floor_belief is None:
        return ()
    floors = sighting.floor_index
    if floors is None:
        floors = np.full(len(sighting.weight), np.argmax(state.floor_belief))
    found = []
    for alike in _groups(sighting.places, sighting.weight, floors):
        weight = sighting.weight[alike]
        x_m, y_m = weight @ sighting.places[alike] / weight.sum()
        floor_id = site.floors[floors[alike[0]]].floor_id
        found.append(Alternative(floor_id, float(x_m), float(y_m), float(weight.sum())))
    return tuple(sorted(found, key=lambda one: -one.weight))


def _groups(places: FloatArray, weight: FloatArray, floors: IntArray) -> Iterator[IntArray]:
    """Yield candidates that mean one place: the heaviest left, and what lies near it."""
    left = list(np.argsort(-weight, kind="stable"))
    while left:
        head = left[0]
        apart_m = np.linalg.norm(places[left] - places[head], axis=1)
        near = (apart_m <= ALIKE_M) & (floors[left] == floors[head])
        yield np.array(left)[near]
        left = [one for one, is_near in zip(left, near, strict=True) if not is_near]
