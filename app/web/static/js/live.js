// From the server to the page's state: what the place is, who is there, and every report after.

import * as api from "./api.js";
import { askForToken } from "./login.js";
import { newPerson, orderOf, withFix, withName, withoutFix } from "./people.js";
import { LiveStream } from "./stream.js";

const NAMES_AGAIN_MS = 5_000; // how often a stranger may make the page ask for names

export class Live {
  #store;
  #actions;
  #clocks;
  #stream = null;
  #namesAskedMs = -Infinity;

  constructor(store, actions, clocks) {
    this.#store = store;
    this.#actions = actions;
    this.#clocks = clocks;
  }

  start() {
    this.#stream = new LiveStream(api.streamUrl(window.location), {
      prepare: () => this.#prepare(),
      isPassing: (error) => error instanceof api.ServerLostError || error.status >= 500,
      // A snapshot tells what was, an event what is: only it proves that the phone is there now.
      onSnapshot: (reports) => this.#receive(reports, ({ time }) => Date.parse(time)),
      onEvent: (reports) => this.#receive(reports, this.#clocks.wallMs),
      onConnection: (connection, problem) => this.#store.change((state) => Object.assign(state, { connection, problem })),
    });
    return this.#stream.start();
  }

  /** Leave this site for another. */
  showSite(siteId) {
    this.#stream.stop();
    this.#store.change((state) => {
      Object.assign(state, { siteId, selectedId: null, following: false, order: [] });
      state.people.clear();
    });
    return this.start();
  }

  /** Load what may have changed while there was no connection; return what to subscribe to. */
  async #prepare() {
    const sites = await this.#loadSites();
    const { state } = this.#store;
    const kept = sites.find((site) => site.site_id === state.siteId) ?? sites[0];
    const siteId = kept?.site_id ?? null;
    this.#store.change(() => Object.assign(state, { sites, siteId }));
    if (siteId === null) return {};
    await this.#loadPlace(siteId);
    await this.#loadNames();
    return { site_id: siteId };
  }

  async #loadSites() {
    try {
      return await api.sites();
    } catch (error) {
      if (error.status !== 401) throw error;
      await askForToken();
      return api.sites();
    }
  }

  async #loadPlace(siteId) {
    const [floors, beacons] = await Promise.all([api.floors(siteId), api.beacons(siteId)]);
    floors.sort((a, b) => a.building.localeCompare(b.building) || a.ordinal - b.ordinal);
    this.#store.change((state) => Object.assign(state, { floors, beacons }));
    const shown = floors.some((floor) => floor.floor_id === this.#store.state.floorId);
    if (!shown && floors.length) this.#actions.showFloor(floors[0].floor_id);
  }

  async #loadNames() {
    this.#namesAskedMs = this.#clocks.pageMs();
    const devices = await api.devices();
    this.#store.change((state) => {
      const here = devices.filter(({ site_id: siteId }) => siteId === null || siteId === state.siteId);
      for (const device of here) state.people.set(device.device_id, named(state.people.get(device.device_id), device));
      state.order = orderOf(state.people.values());
    });
  }

  #receive(reports, seenMsOf) {
    const clockMs = this.#clocks.pageMs();
    this.#store.change((state) => {
      const before = state.people.size;
      for (const report of reports) {
        const id = report.device_id;
        const person = state.people.get(id) ?? newPerson(id, id);
        state.people.set(id, reported(person, report, { seenMs: seenMsOf(report), clockMs }));
      }
      if (state.people.size > before) this.#meetStrangers(state);
    });
    this.#actions.followFloor();
  }

  #meetStrangers(state) {
    state.order = orderOf(state.people.values());
    if (this.#clocks.pageMs() - this.#namesAskedMs < NAMES_AGAIN_MS) return;
    this.#loadNames().catch((error) => {
      // The stream notices a lost server too, and loads the names when it is back.
      if (!(error instanceof api.ServerLostError)) throw error;
    });
  }
}

function named(person, device) {
  const name = device.person || device.name || device.device_id;
  if (person) return withName(person, name);
  return newPerson(device.device_id, name, device.last_seen ? Date.parse(device.last_seen) : null);
}

function reported(person, report, { seenMs, clockMs }) {
  return report.no_fix
    ? withoutFix(person, report.no_fix.reason, seenMs)
    : withFix(person, report, seenMs, clockMs);
}
