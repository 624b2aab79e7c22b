// The people on the map: one canvas, drawn when something changed and while somebody glides.

import { toPixels } from "./map.js";
import { isGliding, shownPosition, STATUSES, statusOf } from "./people.js";
import {
  drawBeacons, drawCircles, drawLabel, drawMarks, drawSelection, drawTrail,
} from "./shapes.js";
import { onThemeChange, themeColours } from "./theme.js";

const MOST_FILLED = 150; // translucent fills by the hundred are slow where software draws
const FRAME_MS = 33; // a walker moves less than a pixel or two in this time
const REACH_PX = 14;
const MARGIN_PX = 40;

export function createPeopleLayer(map, store, clocks, reducedMotion) {
  const container = map.leaflet.getContainer();
  const canvas = container.appendChild(document.createElement("canvas"));
  canvas.className = "people-canvas";
  const ctx = canvas.getContext("2d");
  let colours = themeColours();
  let scheduled = false;
  let drawnMs = -Infinity;

  const glideMs = () => (reducedMotion ? Infinity : clocks.pageMs());

  /** The people of the shown floor as marks in pixels of the container. */
  function marks() {
    const { state } = store;
    const frame = map.frame();
    const now = clocks.wallMs();
    const found = [];
    for (const person of state.people.values()) {
      if (person.fix === null || person.fix.floor_id !== state.floorId) continue;
      const { x, y } = shownPosition(person, glideMs());
      found.push({
        person, x, y, ...toPixels(frame, x, y), name: person.name,
        status: statusOf(person, now), radiusPx: person.fix.radius95_m * frame.pxPerM,
      });
    }
    return found;
  }

  function resize() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(container.clientWidth * ratio);
    canvas.height = Math.round(container.clientHeight * ratio);
    canvas.style.width = `${container.clientWidth}px`;
    canvas.style.height = `${container.clientHeight}px`;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw();
  }

  function draw() {
    drawnMs = clocks.pageMs();
    ctx.clearRect(0, 0, canvas.width, canvas.height);
    const { state } = store;
    const all = marks();
    const inSight = all.filter((mark) => isInSight(mark, container));
    const selected = all.find((mark) => mark.person.id === state.selectedId);
    if (state.layers.beacons) drawBeacons(ctx, beaconPoints(), colours.beacon);
    drawExtents(inSight, selected);
    drawTrails(inSight, selected);
    for (const status of [...STATUSES].reverse()) {
      drawMarks(ctx, inSight.filter((mark) => mark.status === status), status, colours);
    }
    if (selected) drawSelection(ctx, selected, colours.accent);
    drawNames(inSight, selected);
  }

  function beaconPoints() {
    const frame = map.frame();
    return store.state.beacons
      .filter((beacon) => beacon.floor_id === store.state.floorId)
      .map((beacon) => toPixels(frame, beacon.x_m, beacon.y_m));
  }

  function drawExtents(inSight, selected) {
    const shown = store.state.layers.uncertainty ? inSight : inSight.filter((mark) => mark === selected);
    const heard = shown.filter((mark) => mark.status !== "offline");
    for (const status of ["live", "stale"]) {
      const group = heard.filter((mark) => mark.status === status);
      drawCircles(ctx, group, colours[status], heard.length <= MOST_FILLED);
    }
  }

  function drawTrails(inSight, selected) {
    const shown = store.state.layers.trails ? inSight : inSight.filter((mark) => mark === selected);
    const frame = map.frame();
    for (const mark of shown) {
      const past = mark.person.trail.slice(0, -1).filter((point) => point.floorId === store.state.floorId);
      const points = past.map((point) => toPixels(frame, point.x, point.y));
      drawTrail(ctx, [...points, mark], colours[mark.status], mark === selected);
    }
  }

  function drawNames(inSight, selected) {
    const { layers, hoveredId } = store.state;
    for (const mark of inSight) {
      const strong = mark === selected;
      if (layers.names || strong || mark.person.id === hoveredId) drawLabel(ctx, mark, colours, strong);
    }
  }

  function keepCentred() {
    const { state } = store;
    if (!state.following) return;
    const mark = marks().find(({ person }) => person.id === state.selectedId);
    if (mark) map.centre(mark.x, mark.y);
  }

  function frame() {
    scheduled = false;
    if (clocks.pageMs() - drawnMs >= FRAME_MS) {
      keepCentred();
      draw();
    }
    if (clocks.pageMs() - drawnMs >= FRAME_MS || anyoneGlides()) schedule();
  }

  function anyoneGlides() {
    for (const person of store.state.people.values()) {
      if (person.fix?.floor_id === store.state.floorId && isGliding(person, glideMs())) return true;
    }
    return false;
  }

  function schedule() {
    if (scheduled) return;
    scheduled = true;
    requestAnimationFrame(frame);
  }

  /** The person drawn nearest to a point of the container, within reach of a finger's tip. */
  function at(px, py) {
    let nearest = null;
    let best = REACH_PX;
    for (const mark of marks()) {
      const distance = Math.hypot(mark.px - px, mark.py - py);
      if (distance < best) [nearest, best] = [mark, distance];
    }
    return nearest?.person.id ?? null;
  }

  map.leaflet.on("move zoom viewreset", draw);
  new ResizeObserver(() => {
    map.leaflet.invalidateSize({ animate: false });
    resize();
  }).observe(container);
  onThemeChange(() => {
    colours = themeColours();
    schedule();
  });
  store.subscribe(schedule);
  resize();
  return { marks, at, schedule };
}

function isInSight({ px, py, radiusPx }, container) {
  const margin = radiusPx + MARGIN_PX;
  return px > -margin && py > -margin && px < container.clientWidth + margin && py < container.clientHeight + margin;
}
