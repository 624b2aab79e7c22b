// What a viewer can do, by whatever means they ask for it.

import { listed } from "./people.js";

export function createActions(store, map, nowMs) {
  function showFloor(floorId) {
    const floor = store.state.floors.find((each) => each.floor_id === floorId);
    if (!floor) return;
    store.change((state) => { state.floorId = floorId; });
    map.showFloor(floor);
  }

  /** Select somebody (or nobody) and turn to the floor they are on. */
  function select(id) {
    store.change((state) => {
      if (state.selectedId !== id) state.following = false;
      state.selectedId = id;
    });
    const fix = store.state.people.get(id)?.fix;
    if (fix && fix.floor_id !== store.state.floorId) showFloor(fix.floor_id);
  }

  function step(by) {
    const ids = listed(store.state, nowMs()).map((person) => person.id);
    if (ids.length === 0) return;
    const current = ids.indexOf(store.state.selectedId);
    const next = current < 0 ? (by > 0 ? 0 : ids.length - 1) : current + by;
    select(ids[Math.min(ids.length - 1, Math.max(0, next))]);
  }

  function follow(wanted) {
    store.change((state) => { state.following = wanted; });
    if (wanted) centre();
  }

  function centre() {
    const fix = store.state.people.get(store.state.selectedId)?.fix;
    if (!fix) return;
    if (fix.floor_id !== store.state.floorId) showFloor(fix.floor_id);
    map.centre(fix.x, fix.y, true);
  }

  /** Keep to the followed person when they change floors. */
  function followFloor() {
    const { state } = store;
    const fix = state.following ? state.people.get(state.selectedId)?.fix : null;
    if (fix && fix.floor_id !== state.floorId) showFloor(fix.floor_id);
  }

  return {
    showFloor,
    select,
    step,
    follow,
    centre,
    followFloor,
    fit() {
      store.change((state) => { state.following = false; });
      map.fit();
    },
    search: (query) => store.change((state) => { state.query = query; }),
    /** Keep the selected person if the search left them in the list, else take its first. */
    selectListed() {
      const people = listed(store.state, nowMs());
      const kept = people.some(({ id }) => id === store.state.selectedId);
      if (!kept && people.length) select(people[0].id);
    },
  };
}
