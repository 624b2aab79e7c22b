// A person is a phone as the page knows it. Every function here is pure.
//
// {id, name, fix, noFixReason, seenMs, fixSeenMs, from: {x, y}, startMs, durationMs, trail: [{x, y, floorId, atMs}]}
// seenMs and fixSeenMs are wall-clock milliseconds; startMs, durationMs and atMs run on the page's
// own monotonic clock.

export const STATUSES = ["live", "stale", "offline"];

const LIVE_MS = 15_000; // a phone posts every second or two; Wi-Fi scans may be 8 s apart
const OFFLINE_MS = 300_000;
const TRAIL_MS = 60_000;
const LONGEST_GLIDE_MS = 1_000;
const SHORTEST_GLIDE_MS = 150;
const FARTHEST_GLIDE_M = 15; // farther in one report is a correction, not a walk

export function newPerson(id, name, seenMs = null) {
  return {
    id, name, fix: null, noFixReason: null, seenMs, fixSeenMs: null,
    from: null, startMs: 0, durationMs: 0, trail: [],
  };
}

export function withName(person, name) {
  return { ...person, name };
}

/** The person after a fix; they glide there from where they are shown at `clockMs`. */
export function withFix(person, fix, seenMs, clockMs) {
  const shown = shownPosition(person, clockMs);
  const glides = shown !== null && person.fix.floor_id === fix.floor_id
    && Math.hypot(fix.x - shown.x, fix.y - shown.y) <= FARTHEST_GLIDE_M;
  const sinceLastMs = clockMs - person.startMs;
  const trail = person.trail.filter((point) => clockMs - point.atMs <= TRAIL_MS);
  return {
    ...person,
    fix,
    noFixReason: null,
    seenMs: Math.max(person.seenMs, seenMs),
    fixSeenMs: Math.max(person.fixSeenMs, seenMs),
    from: glides ? shown : { x: fix.x, y: fix.y },
    startMs: clockMs,
    durationMs: glides ? Math.min(LONGEST_GLIDE_MS, Math.max(SHORTEST_GLIDE_MS, sinceLastMs)) : 0,
    trail: [...trail, { x: fix.x, y: fix.y, floorId: fix.floor_id, atMs: clockMs }],
  };
}

/** The person after a report without a position: the last one stays, and grows stale. */
export function withoutFix(person, reason, seenMs) {
  return { ...person, noFixReason: reason, seenMs: Math.max(person.seenMs, seenMs) };
}

/** Where to draw the person now, or null if they never had a position. */
export function shownPosition(person, clockMs) {
  if (person.fix === null) return null;
  const progress = glideProgress(person, clockMs);
  return {
    x: person.from.x + (person.fix.x - person.from.x) * progress,
    y: person.from.y + (person.fix.y - person.from.y) * progress,
  };
}

export function isGliding(person, clockMs) {
  return person.fix !== null && glideProgress(person, clockMs) < 1;
}

function glideProgress(person, clockMs) {
  if (person.durationMs === 0) return 1;
  return Math.min(1, Math.max(0, (clockMs - person.startMs) / person.durationMs));
}

export function statusOf(person, nowMs) {
  if (person.seenMs === null || nowMs - person.seenMs > OFFLINE_MS) return "offline";
  if (person.fixSeenMs === null || nowMs - person.fixSeenMs > LIVE_MS) return "stale";
  return "live";
}

export function countStatuses(people, nowMs) {
  const counts = { live: 0, stale: 0, offline: 0 };
  for (const person of people) counts[statusOf(person, nowMs)] += 1;
  return counts;
}

export function countByFloor(people) {
  const counts = new Map();
  for (const { fix } of people) {
    if (fix !== null) counts.set(fix.floor_id, (counts.get(fix.floor_id) ?? 0) + 1);
  }
  return counts;
}

const byName = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });

/** Device ids in the order of the list: by name, numbers as numbers. */
export function orderOf(people) {
  return [...people]
    .sort((a, b) => byName.compare(a.name, b.name) || byName.compare(a.id, b.id))
    .map((person) => person.id);
}

/** The people that the search and the chosen status leave in the list. */
export function listed(state, nowMs) {
  const wanted = state.query.trim().toLocaleLowerCase();
  return state.order
    .map((id) => state.people.get(id))
    .filter((person) => state.onlyStatus === null || statusOf(person, nowMs) === state.onlyStatus)
    .filter((person) => `${person.name}\n${person.id}`.toLocaleLowerCase().includes(wanted));
}
