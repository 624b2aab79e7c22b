"""Walks through the simulated warehouse while one beacon in eight is bad: who is named, how soon.

``python tests/accuracy/faulty_walks.py`` prints the table. A bad beacon is dead (silent), moved
(its signal comes from a place 15 m off) or duplicated (from both places), from the first second on.
There is no Wi-Fi and no radio map.

A walker is at a beacon while he is on its floor and within `NEAR_M` of one of its places: where the
registry has it, or, if it was moved or duplicated, where the signal comes from. Time counts from
his first second there; passers-by who leave before `STAY_S` ask nothing.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.engine import advance, start
from app.core.params import Params
from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.core.simulate.phone import ble_scans
from app.core.simulate.radio import Transmitters, transmitters
from app.core.types import Anchor, BleScan, Observation, TrackPoint, WifiScan

KINDS = ("dead", "moved", "duplicated")
BAD_ONE_IN, MOVED_M = 8, 15.0
NEAR_M, NAMED_S, STAY_S = 6.0, 10, 4
LATER_S = 0.2
"""Two transmitters do not send at the same instants."""
START_S, DURATION_S = 1_790_000_000.0, 120
HEADING = (
    "| bad beacons | error m | ratio | of first 10 s | false | dead | moved | duplicated |\n"
    "|---|---|---|---|---|---|---|---|\n"
)
Said = list[dict[str, str | None]]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """One walk, second by second.

    Attributes
    ----------
    error_m : (seconds,)
        nan where there was no fix.
    at_beacon : (seconds, beacons)
        See above.
    said
        Per second the beacons blamed, each with the kind told.
    kind_of
        The truth of the bad ones.
    """

    error_m: np.ndarray
    at_beacon: np.ndarray
    said: Said
    kind_of: dict[str, str]
    beacon_ids: list[str]

    def false_seconds(self) -> int:
        """Return in how many seconds a healthy beacon was blamed."""
        return sum(any(one not in self.kind_of for one in said) for said in self.said)

    def delays(self) -> list[tuple[str, float, bool]]:
        """Return of each bad beacon that he was at: kind, delay until named, kind told rightly."""
        found = []
        for beacon_id, kind in self.kind_of.items():
            at = self.at_beacon[:, self.beacon_ids.index(beacon_id)]
            first = int(np.argmax(at))
            in_time = range(first, first + NAMED_S + 1)
            if in_time.stop > len(at) or at[in_time].sum() < STAY_S:
                continue
            named = [i for i in range(first, len(at)) if beacon_id in self.said[i]]
            delay = named[0] - first if named else np.inf
            right = bool(named) and self.said[min(named[0] + 5, len(at) - 1)].get(beacon_id) == kind
            found.append((kind, float(delay), right))
        return found


def bad_beacons(world: Warehouse, rng: np.random.Generator) -> tuple[list[int], Transmitters]:
    """Return which beacons are bad, and all beacons as if each had been moved by 15 m."""
    anchors = world.beacons.anchors
    bad = sorted(rng.choice(len(anchors), len(anchors) // BAD_ONE_IN, replace=False).tolist())
    elsewhere = tuple(_moved(world, anchor, rng) for anchor in anchors)
    return bad, transmitters(elsewhere, world.site.floors, world.beacons.detection_dbm, rng)


def _moved(world: Warehouse, anchor: Anchor, rng: np.random.Generator) -> Anchor:
    floor = next(f for f in world.site.floors if f.floor_id == anchor.floor_id)
    while True:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        x_m, y_m = anchor.x_m + MOVED_M * np.cos(angle), anchor.y_m + MOVED_M * np.sin(angle)
        if 1.0 < x_m < floor.width_m - 1.0 and 1.0 < y_m < floor.height_m - 1.0:
            return replace(anchor, x_m=float(x_m), y_m=float(y_m))


def with_faults(
    one: SimulatedWalk, kind_of: dict[int, str], elsewhere: Transmitters, seed: int
) -> list[Observation]:
    """Return what the phone reports where some beacons are bad; Wi-Fi is left away."""
    far = ble_scans(one.phone, one.truth, elsewhere, np.random.default_rng([seed, 99]))
    far_by_s = {scan.time_s: scan for scan in far}
    gone = {elsewhere.anchors[i].keys for i, kind in kind_of.items() if kind != "duplicated"}
    added = {elsewhere.anchors[i].keys for i, kind in kind_of.items() if kind != "dead"}
    told: list[Observation] = []
    for observation in one.observations:
        if isinstance(observation, WifiScan):
            continue
        if not isinstance(observation, BleScan):
            told.append(observation)
        else:
            here = [r for r in observation.readings if r.keys not in gone]
            far_readings = far_by_s[observation.time_s].readings
            here += [replace(r, age_s=r.age_s - LATER_S) for r in far_readings if r.keys in added]
            told.append(BleScan(observation.time_s, tuple(here)))
    return told


def follow(world: Warehouse, seed: int, kinds: Sequence[str]) -> Followed:
    """Follow walker ``seed``; the bad beacons are of these kinds in turn (none: all are well)."""
    bad, elsewhere = bad_beacons(world, np.random.default_rng([world.seed, seed, 7]))
    kind_of = {i: kinds[n % len(kinds)] for n, i in enumerate(bad)} if kinds else {}
    one = walk(world, seed, START_S, float(DURATION_S), imu=seed % 2 == 1)
    site, state = replace(world.site, radio_map=None), start()
    said: Said = [{} for _ in range(DURATION_S + 1)]
    error_m = np.full(DURATION_S + 1, np.nan)
    for observation in with_faults(one, kind_of, elsewhere, seed):
        state, outputs = advance(state, observation, site, Params())
        second = round(observation.time_s - START_S)
        if isinstance(observation, BleScan) and second <= DURATION_S:
            said[second] = dict(state.evidence.left_out)
        for output in outputs:
            if isinstance(output, TrackPoint) and output.time_s <= START_S + DURATION_S:
                truth = one.truth_at(output.time_s)
                gap_m = np.hypot(output.x_m - truth.x_m, output.y_m - truth.y_m)
                error_m[int(output.time_s - START_S)] = gap_m
    ids = [anchor.anchor_id for anchor in site.anchors]
    named = {ids[i]: kind for i, kind in kind_of.items()}
    return Followed(error_m, _at_beacon(world, one, elsewhere, kind_of), said, named, ids)


def _at_beacon(
    world: Warehouse, one: SimulatedWalk, elsewhere: Transmitters, kind_of: dict[int, str]
) -> np.ndarray:
    at = one.truth.points_at(START_S + np.arange(DURATION_S + 1.0))
    here, far = world.beacons.place, elsewhere.place
    gap_m = np.hypot(at[:, :1] - here[:, 0], at[:, 1:2] - here[:, 1])
    far_m = np.hypot(at[:, :1] - far[:, 0], at[:, 1:2] - far[:, 1])
    heard_there = [i for i, kind in kind_of.items() if kind != "dead"]
    gap_m[:, heard_there] = np.minimum(gap_m, far_m)[:, heard_there]
    return (gap_m <= NEAR_M) & (np.abs(at[:, 2:3] - here[:, 3]) < 0.25)


def row(name: str, walks: Sequence[Followed], healthy: Sequence[Followed]) -> str:
    """Return a line of the table."""
    error, usual = (np.concatenate([w.error_m for w in each]) for each in (walks, healthy))
    first, first_usual = (
        np.concatenate([w.error_m[:NAMED_S] for w in each]) for each in (walks, healthy)
    )
    seconds = sum(len(w.said) for w in walks)
    false = sum(w.false_seconds() for w in walks) / seconds
    told = f"{np.nanmean(error):.2f} | {np.nanmean(error) / np.nanmean(usual):.2f}"
    told += f" | {np.nanmean(first) / np.nanmean(first_usual):.2f} | {false:.1%}"
    for kind in KINDS:
        found = [(delay, right) for w in walks for k, delay, right in w.delays() if k == kind]
        if not found:
            told += " | "
            continue
        delay, right = zip(*found, strict=True)
        in_time = np.array(delay) <= NAMED_S
        told += f" | {in_time.mean():.0%} of {len(found)}, median {np.median(delay):.0f} s,"
        told += f" kind right {sum(right)}/{int(np.isfinite(delay).sum())}"
    return f"| {name} | {told} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, nargs="+", default=[200, 201, 202])
    parser.add_argument("--walkers", type=int, default=8)
    asked = parser.parse_args()
    sys.stdout.write(HEADING)
    worlds = [warehouse(seed) for seed in asked.worlds]
    healthy: list[Followed] = []
    for kinds in ((), *((kind,) for kind in KINDS), KINDS):
        walks = [follow(world, 100 + n, kinds) for world in worlds for n in range(asked.walkers)]
        healthy = healthy or walks
        sys.stdout.write(row(" + ".join(kinds) or "none", walks, healthy) + "\n")


if __name__ == "__main__":
    main()
