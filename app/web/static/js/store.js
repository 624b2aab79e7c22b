// The page's state and who wants to know of changes; listeners run at most once per frame.

export function createStore(state) {
  const listeners = new Set();
  let scheduled = false;

  function notify() {
    scheduled = false;
    for (const listener of listeners) listener(state);
  }

  return {
    state,
    change(apply) {
      apply(state);
      if (scheduled) return;
      scheduled = true;
      requestAnimationFrame(notify);
    },
    subscribe(listener) {
      listeners.add(listener);
    },
  };
}

export function initialState() {
  return {
    connection: "connecting", // connecting | live | reconnecting | failed
    problem: "",
    sites: [],
    siteId: null,
    floors: [],
    floorId: null,
    beacons: [],
    people: new Map(), // device_id -> person (people.js)
    order: [], // device ids by name
    selectedId: null,
    hoveredId: null,
    following: false,
    query: "",
    onlyStatus: null,
    layers: { uncertainty: true, trails: false, beacons: true, names: false },
  };
}

export function floorName(state, floorId) {
  return state.floors.find((floor) => floor.floor_id === floorId)?.name ?? "—";
}
