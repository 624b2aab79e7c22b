"""The one-shot question: a fresh fold over what was heard, nothing kept."""

import asyncio
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from app.core import engine
from app.core.engine import SessionState, order_key, places_of
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import Observation, Output


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
    by_key = {order_key(o): o for o in observations}
    ordered = [by_key[key] for key in sorted(by_key)]
    return await asyncio.to_thread(_fold, site, params, ordered)


def _fold(site: SiteModel, params: Params, ordered: Sequence[Observation]) -> Located:
    state = engine.start()
    for observation in ordered:
        state, _ = engine.advance(state, observation, site, params)
    outputs = engine.finish(state, site, params)
    return Located(outputs[-1] if outputs else None, _alternatives(state, site))


def _alternatives(state: SessionState, site: SiteModel) -> tuple[Alternative, ...]:
    """Return the places that the track holds possible, on the most probable floor."""
    if state.track is None or state.floor_belief is None:
        return ()
    floor = int(np.argmax(state.floor_belief))
    share = float(state.floor_belief[floor])
    return tuple(
        Alternative(
            site.floors[floor].floor_id, float(place[0]), float(place[1]), float(weight) * share
        )
        for place, weight in zip(*places_of(state.track), strict=True)
    )
