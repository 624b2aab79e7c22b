// A window into the page for tests and for the curious: reads, changes nothing.

import { toPixels } from "./map.js";

/** Pixels are those of the browser window, where a mouse would point. */
export function publishView(store, map, layer) {
  const corner = () => map.leaflet.getContainer().getBoundingClientRect();

  const view = {
    people() {
      const { left, top } = corner();
      return layer.marks().map(({ person, x, y, px, py, status, radiusPx }) => ({
        device_id: person.id, name: person.name, floor_id: person.fix.floor_id,
        x, y, px: px + left, py: py + top, radius_px: radiusPx, status,
      }));
    },
    toPixels(x, y) {
      const { left, top } = corner();
      const { px, py } = toPixels(map.frame(), x, y);
      return { px: px + left, py: py + top };
    },
    get connection() { return store.state.connection; },
    get floor_id() { return store.state.floorId; },
    get selected_id() { return store.state.selectedId; },
    get following() { return store.state.following; },
  };
  Object.defineProperty(window, "__view", { value: Object.freeze(view) });
}
