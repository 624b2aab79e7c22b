// The plan under the people: Leaflet in plain metres, one floor at a time.

import { Control, CRS, ImageOverlay, Map as LeafletMap, Rectangle } from "../leaflet/leaflet-src.esm.js";
import { planUrl } from "./api.js";

const PAN_PX = 80;
const FIT_PADDING_PX = [28, 48]; // room for the toolbar above and the scale below
const CLOSE_ZOOM = 4.5; // 2^4.5 = 23 px per metre

const latLng = (x, y) => [y, x];

export function createMap(reducedMotion) {
  const map = new LeafletMap("map", {
    crs: CRS.Simple,
    minZoom: -2,
    maxZoom: 7,
    zoomSnap: 0.25,
    zoomDelta: 0.5,
    wheelPxPerZoomLevel: 120,
    // The canvas of people is drawn, not scaled, with each view; a zoom is one step.
    zoomAnimation: false,
    fadeAnimation: false,
    markerZoomAnimation: false,
    inertia: !reducedMotion,
    keyboard: false,
    attributionControl: false,
    zoomControl: false,
    center: [0, 0],
    zoom: 0,
  });
  new Control.Zoom({ position: "bottomright" }).addTo(map);
  new Control.Scale({ position: "bottomleft", imperial: false, maxWidth: 120 }).addTo(map);
  let shownFloor = null;
  let layers = [];

  function showFloor(floor) {
    layers.forEach((layer) => layer.remove());
    const bounds = boundsOf(floor);
    layers = [new Rectangle(bounds, { className: "floor-sheet", interactive: false, pane: "tilePane" })];
    if (floor.has_plan) layers.push(new ImageOverlay(planUrl(floor), bounds, { className: "plan-image", alt: "" }));
    layers.forEach((layer) => layer.addTo(map));
    const sameFrame = shownFloor !== null && sameBounds(shownFloor, floor);
    shownFloor = floor;
    if (!sameFrame) fit();
  }

  function fit() {
    if (shownFloor !== null) map.fitBounds(boundsOf(shownFloor), { padding: FIT_PADDING_PX, animate: false });
  }

  return {
    leaflet: map,
    showFloor,
    fit,
    pan: (dx, dy) => map.panBy([dx * PAN_PX, dy * PAN_PX], { animate: !reducedMotion }),
    zoomIn: () => map.zoomIn(),
    zoomOut: () => map.zoomOut(),
    /** Put a place in the middle; `close` also makes sure that it is seen from near. */
    centre(x, y, close = false) {
      const zoom = close ? Math.max(map.getZoom(), CLOSE_ZOOM) : map.getZoom();
      map.setView(latLng(x, y), zoom, { animate: false });
    },
    /** Origin in the container and pixels per metre: all that drawing needs. */
    frame() {
      const origin = map.latLngToContainerPoint([0, 0]);
      return { originX: origin.x, originY: origin.y, pxPerM: CRS.Simple.scale(map.getZoom()) };
    },
  };
}

function boundsOf(floor) {
  return [latLng(floor.x0_m, floor.y0_m), latLng(floor.x0_m + floor.width_m, floor.y0_m + floor.height_m)];
}

function sameBounds(a, b) {
  return JSON.stringify(boundsOf(a)) === JSON.stringify(boundsOf(b));
}

/** A place in metres to pixels of the map's container (plan y points up, pixels down). */
export function toPixels(frame, x, y) {
  return { px: frame.originX + x * frame.pxPerM, py: frame.originY - y * frame.pxPerM };
}
