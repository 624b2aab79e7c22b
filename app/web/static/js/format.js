// Numbers and codes as people read them.

const METHODS = {
  lateration: "Lateration",
  fingerprint: "Fingerprint",
  dead_reckoning: "Dead reckoning",
  fused: "Fused",
};

const NO_FIX_REASONS = {
  nothing_heard: "The phone hears no transmitter.",
  too_few_transmitters: "The phone hears too few transmitters to tell where it is.",
  unknown_transmitters: "None of the transmitters heard is known at this site.",
  readings_too_old: "What the phone heard is too old.",
  degenerate_geometry: "The beacons heard stand in a line: the side of it cannot be told.",
  outside_mapped_area: "The phone seems to be outside the mapped area.",
  no_radio_map_or_beacons: "This site has no radio map and no beacons.",
  no_beacons: "This profile needs beacons, and this site has none.",
  not_started: "Too little has been heard since the session began.",
  nothing_observed: "The phone has told nothing yet.",
};

export const STATUS_NAMES = { live: "Live", stale: "Stale", offline: "Offline" };

export function metres(value) {
  return `${value.toFixed(1)} m`;
}

export function sinceWords(seenMs, nowMs) {
  if (seenMs === null) return "never";
  const seconds = Math.max(0, Math.round((nowMs - seenMs) / 1000));
  if (seconds < 2) return "now";
  if (seconds < 60) return `${seconds} s ago`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  if (seconds < 86_400) return `${Math.floor(seconds / 3600)} h ago`;
  return `${Math.floor(seconds / 86_400)} d ago`;
}

export function methodWords(fix) {
  return METHODS[fix.method] ?? fix.method;
}

export function noFixWords(reason) {
  return NO_FIX_REASONS[reason] ?? reason;
}

export function motionWords(fix) {
  if (fix.motion === "still") return "Still";
  const heading = fix.heading_deg == null ? "" : `, ${Math.round(fix.heading_deg)}°`;
  return `Walking ${fix.speed_mps.toFixed(1)} m/s${heading}`;
}

export function usedWords(used) {
  const parts = [
    counted(used.beacons, "beacon", "beacons"),
    counted(used.access_points, "access point", "access points"),
    counted(used.steps, "step", "steps"),
  ].filter((part) => part !== null);
  return parts.length ? parts.join(", ") : "nothing new";
}

function counted(count, one, many) {
  if (!count) return null;
  return `${count} ${count === 1 ? one : many}`;
}
