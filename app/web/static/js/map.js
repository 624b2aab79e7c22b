// The plan under the people: Leaflet in plain metres, one floor at a time.

import { Control, CRS, ImageOverlay, Map as LeafletMap, Rectangle } from "../leaflet/leaflet-src.esm.js";

const PAN_PX = 80;
const FIT_PADDING_PX = [28, 48]; // room for the toolbar above and the scale below
const CLOSE_ZOOM = 4.5; // 2^4.5 = 23 px per metre

const OPTIONS = {
  crs: CRS.Simple,
  center: [0, 0],
  zoom: 0,
  minZoom: -2,
  maxZoom: 7,
  zoomSnap: 0.1,
  zoomDelta: 0.5,
  wheelPxPerZoomLevel: 120,
  // The canvas of people is drawn anew for each view, never scaled: a zoom is one step.
  zoomAnimation: false,
  fadeAnimation: false,
  markerZoomAnimation: false,
  keyboard: false, // keys.js
  attributionControl: false,
  zoomControl: false,
};

export class FloorMap {
  #reducedMotion;
  #floor = null;
  #layers = [];

  constructor(reducedMotion) {
    this.#reducedMotion = reducedMotion;
    this.leaflet = new LeafletMap("map", { ...OPTIONS, inertia: !reducedMotion });
    new Control.Zoom({ position: "bottomright" }).addTo(this.leaflet);
    new Control.Scale({ position: "bottomleft", imperial: false, maxWidth: 120 }).addTo(this.leaflet);
  }

  /** Show a floor; the view stays where it is if the floors lie over each other. */
  showFloor(floor) {
    const bounds = boundsOf(floor);
    const sheet = new Rectangle(bounds, { className: "floor-sheet", interactive: false, pane: "tilePane" });
    for (const layer of this.#layers) layer.remove();
    this.#layers = [sheet];
    if (floor.plan) this.#layers.push(new ImageOverlay(floor.plan, bounds, { className: "plan-image", alt: "" }));
    for (const layer of this.#layers) layer.addTo(this.leaflet);
    const sameFrame = this.#floor !== null && String(boundsOf(this.#floor)) === String(bounds);
    this.#floor = floor;
    if (!sameFrame) this.fit();
  }

  fit() {
    if (this.#floor === null) return;
    this.leaflet.fitBounds(boundsOf(this.#floor), { padding: FIT_PADDING_PX, animate: false });
  }

  pan(right, down) {
    this.leaflet.panBy([right * PAN_PX, down * PAN_PX], { animate: !this.#reducedMotion });
  }

  zoomIn() {
    this.leaflet.zoomIn();
  }

  zoomOut() {
    this.leaflet.zoomOut();
  }

  /** Put a place in the middle; `close` also makes sure that it is seen from near. */
  centre(x, y, close = false) {
    const zoom = close ? Math.max(this.leaflet.getZoom(), CLOSE_ZOOM) : this.leaflet.getZoom();
    this.leaflet.setView(latLng(x, y), zoom, { animate: false });
  }

  /** Where the origin is in the container, and pixels per metre: all that drawing needs. */
  frame() {
    const origin = this.leaflet.latLngToContainerPoint(latLng(0, 0));
    return { originX: origin.x, originY: origin.y, pxPerM: CRS.Simple.scale(this.leaflet.getZoom()) };
  }
}

/** A place in metres to pixels of the map's container (y points up on the plan, down in pixels). */
export function toPixels(frame, x, y) {
  return { px: frame.originX + x * frame.pxPerM, py: frame.originY - y * frame.pxPerM };
}

function latLng(x, y) {
  return [y, x];
}

function boundsOf(floor) {
  return [latLng(floor.x0, floor.y0), latLng(floor.x0 + floor.width, floor.y0 + floor.height)];
}
