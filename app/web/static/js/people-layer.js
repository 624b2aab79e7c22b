// The people on the map: one canvas, drawn when something changed and while somebody glides.

import { toPixels } from "./map.js";
import { isGliding, shownPosition, STATUSES, statusOf } from "./people.js";
import { drawBeacons, drawCircles, drawLabel, drawMarks, drawSelection, drawTrail } from "./shapes.js";
import { onThemeChange, themeColours } from "./theme.js";

const MOST_FILLED = 150; // translucent fills by the hundred are slow where software draws
const FRAME_MS = 33; // a walker moves less than a pixel or two in this time
const REACH_PX = 14; // of a fingertip
const LABEL_PX = 160; // a name may reach into sight from here

export class PeopleLayer {
  #map;
  #store;
  #clocks;
  #reducedMotion;
  #container;
  #canvas;
  #ctx;
  #colours = themeColours();
  #scheduled = false;
  #drawnMs = -Infinity;

  constructor(map, store, clocks, reducedMotion) {
    this.#map = map;
    this.#store = store;
    this.#clocks = clocks;
    this.#reducedMotion = reducedMotion;
    this.#container = map.leaflet.getContainer();
    this.#canvas = this.#container.appendChild(document.createElement("canvas"));
    this.#canvas.className = "people-canvas";
    this.#ctx = this.#canvas.getContext("2d");
    map.leaflet.on("move zoom viewreset", () => this.#draw());
    new ResizeObserver(() => this.#resize()).observe(this.#container);
    onThemeChange(() => {
      this.#colours = themeColours();
      this.#schedule();
    });
    store.subscribe(() => this.#schedule());
  }

  /** The people of the shown floor, with the pixels of the container where they are drawn. */
  marks() {
    const { state } = this.#store;
    const frame = this.#map.frame();
    const nowMs = this.#clocks.wallMs();
    const glideMs = this.#glideMs();
    return [...state.people.values()]
      .filter(({ fix }) => fix?.floor_id === state.floorId)
      .map((person) => {
        const { x, y } = shownPosition(person, glideMs);
        const radiusPx = person.fix.radius95_m * frame.pxPerM;
        return { person, x, y, radiusPx, status: statusOf(person, nowMs), ...toPixels(frame, x, y) };
      });
  }

  /** The person drawn nearest to a point of the container, null if none is within reach. */
  at(px, py) {
    const near = this.marks()
      .map((mark) => ({ id: mark.person.id, distance: Math.hypot(mark.px - px, mark.py - py) }))
      .filter(({ distance }) => distance < REACH_PX)
      .sort((a, b) => a.distance - b.distance);
    return near.length ? near[0].id : null;
  }

  #resize() {
    const { clientWidth, clientHeight } = this.#container;
    const ratio = window.devicePixelRatio || 1;
    this.#canvas.width = Math.round(clientWidth * ratio);
    this.#canvas.height = Math.round(clientHeight * ratio);
    this.#canvas.style.width = `${clientWidth}px`;
    this.#canvas.style.height = `${clientHeight}px`;
    this.#ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.#map.leaflet.invalidateSize({ animate: false });
    this.#draw();
  }

  #schedule() {
    if (this.#scheduled) return;
    this.#scheduled = true;
    requestAnimationFrame(() => this.#frame());
  }

  #frame() {
    this.#scheduled = false;
    const due = this.#clocks.pageMs() - this.#drawnMs >= FRAME_MS;
    if (due) {
      this.#keepCentred();
      this.#draw();
    }
    if (!due || this.#anyoneGlides()) this.#schedule();
  }

  /** With reduced motion every glide is over before it begins. */
  #glideMs() {
    return this.#reducedMotion ? Infinity : this.#clocks.pageMs();
  }

  #anyoneGlides() {
    const { people, floorId } = this.#store.state;
    const glideMs = this.#glideMs();
    return [...people.values()].some((person) => person.fix?.floor_id === floorId && isGliding(person, glideMs));
  }

  #keepCentred() {
    const { following, selectedId } = this.#store.state;
    const followed = following && this.marks().find(({ person }) => person.id === selectedId);
    if (followed) this.#map.centre(followed.x, followed.y);
  }

  #draw() {
    this.#drawnMs = this.#clocks.pageMs();
    this.#ctx.clearRect(0, 0, this.#canvas.width, this.#canvas.height);
    const { layers, selectedId } = this.#store.state;
    const marks = this.marks().filter((mark) => this.#isInSight(mark));
    const selected = marks.filter(({ person }) => person.id === selectedId);
    if (layers.beacons) this.#drawBeacons();
    this.#drawExtents(layers.uncertainty ? marks : selected);
    this.#drawTrails(layers.trails ? marks : selected);
    for (const status of [...STATUSES].reverse()) {
      drawMarks(this.#ctx, marks.filter((mark) => mark.status === status), status, this.#colours);
    }
    for (const mark of selected) drawSelection(this.#ctx, mark, this.#colours.accent);
    this.#drawNames(marks);
  }

  #isInSight({ px, py, radiusPx }) {
    const margin = radiusPx + LABEL_PX;
    const { clientWidth, clientHeight } = this.#container;
    return px > -margin && py > -margin && px < clientWidth + margin && py < clientHeight + margin;
  }

  #drawBeacons() {
    const { beacons, floorId } = this.#store.state;
    const frame = this.#map.frame();
    const here = beacons.filter((beacon) => beacon.floor_id === floorId);
    drawBeacons(this.#ctx, here.map(({ x, y }) => toPixels(frame, x, y)), this.#colours.beacon);
  }

  #drawExtents(marks) {
    const heard = marks.filter(({ status }) => status !== "offline");
    for (const status of ["live", "stale"]) {
      const group = heard.filter((mark) => mark.status === status);
      drawCircles(this.#ctx, group, this.#colours[status], heard.length <= MOST_FILLED);
    }
  }

  #drawTrails(marks) {
    const { floorId, selectedId } = this.#store.state;
    const frame = this.#map.frame();
    for (const mark of marks) {
      const past = mark.person.trail.slice(0, -1).filter((point) => point.floorId === floorId);
      const points = [...past.map(({ x, y }) => toPixels(frame, x, y)), mark];
      drawTrail(this.#ctx, points, this.#colours[mark.status], mark.person.id === selectedId);
    }
  }

  #drawNames(marks) {
    const { layers, hoveredId, selectedId } = this.#store.state;
    for (const mark of marks) {
      const { id, name } = mark.person;
      if (!layers.names && id !== hoveredId && id !== selectedId) continue;
      drawLabel(this.#ctx, { ...mark, name }, this.#colours, id === selectedId);
    }
  }
}
