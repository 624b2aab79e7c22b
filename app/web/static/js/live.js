// From the server to the page's state: what the place is, who is there, and every report after.

import * as api from "./api.js";
import { askForToken } from "./login.js";
import { newPerson, orderOf, withFix, withName, withoutFix } from "./people.js";
import { keepSubscribed } from "./stream.js";

const NAMES_AGAIN_MS = 5_000; // how often a stranger may make the page ask for names

export function createLive(store, actions, clocks) {
  let namesAskedMs = -Infinity;
  let subscription = null;

  async function loadPlace() {
    const sites = await api.sites();
    const siteId = sites.some(({ id }) => id === store.state.siteId) ? store.state.siteId : sites[0]?.id ?? null;
    const [floors, beacons] = siteId === null
      ? [[], []]
      : await Promise.all([api.floors(siteId), api.beacons(siteId)]);
    floors.sort((a, b) => a.building.localeCompare(b.building) || a.ordinal - b.ordinal);
    const known = floors.some(({ id }) => id === store.state.floorId);
    store.change((state) => Object.assign(state, { sites, siteId, floors, beacons }));
    if (!known && floors.length) actions.showFloor(floors[0].id);
    return siteId;
  }

  async function loadNames() {
    namesAskedMs = clocks.pageMs();
    const devices = await api.devices();
    store.change((state) => {
      for (const device of devices) {
        if (device.site_id !== null && device.site_id !== state.siteId) continue;
        const name = device.person || device.name || device.id;
        const known = state.people.get(device.id);
        const seenMs = device.last_seen ? Date.parse(device.last_seen) : null;
        state.people.set(device.id, known ? withName(known, name) : newPerson(device.id, name, seenMs));
      }
      state.order = orderOf(state.people.values());
    });
  }

  /** Load what may have changed while there was no connection; return what to subscribe to. */
  async function prepare() {
    const siteId = await loadPlace().catch(async (error) => {
      if (error.status !== 401) throw error;
      await askForToken();
      return loadPlace();
    });
    await loadNames();
    return siteId === null ? {} : { site_id: siteId };
  }

  function receive(reports, seenMsOf) {
    store.change((state) => {
      const before = state.people.size;
      for (const report of reports) {
        const id = report.device_id;
        const person = state.people.get(id) ?? newPerson(id, id);
        state.people.set(id, reported(person, report, seenMsOf(report)));
      }
      if (state.people.size === before) return;
      state.order = orderOf(state.people.values());
      learnNames();
    });
    actions.followFloor();
  }

  function learnNames() {
    if (clocks.pageMs() - namesAskedMs >= NAMES_AGAIN_MS) loadNames().catch(ignoreLostServer);
  }

  function reported(person, report, seenMs) {
    return report.no_fix
      ? withoutFix(person, report.no_fix.reason, seenMs)
      : withFix(person, report, seenMs, clocks.pageMs());
  }

  function start() {
    subscription = keepSubscribed({
      url: api.streamUrl(window.location),
      prepare,
      isPassing: (error) => error instanceof api.ServerLostError || error.status >= 500,
      // A snapshot tells what was, an event what is: only it proves that the phone is there now.
      onSnapshot: (reports) => receive(reports, (report) => Date.parse(report.time)),
      onEvent: (reports) => receive(reports, clocks.wallMs),
      onConnection: (connection, problem) =>
        store.change((state) => Object.assign(state, { connection, problem })),
    });
  }

  return {
    start,
    /** Leave this site for another. */
    showSite(siteId) {
      subscription.stop();
      store.change((state) => {
        Object.assign(state, { siteId, selectedId: null, following: false, order: [] });
        state.people.clear();
      });
      start();
    },
  };
}

/** The stream notices a lost server by itself and asks for names again when it is back. */
function ignoreLostServer(error) {
  if (!(error instanceof api.ServerLostError)) throw error;
}
