// The buttons above the map: layers and floors.

import { element, setAttribute, setText, toggleButton } from "./dom.js";
import { countByFloor } from "./people.js";

const LAYER_NAMES = { uncertainty: "Uncertainty", trails: "Trails", beacons: "Beacons", names: "Names" };

export function createToolbar(store, actions) {
  const layers = Object.entries(LAYER_NAMES).map(([layer, name]) => {
    const button = toggleButton(
      () => store.change((state) => { state.layers[layer] = !state.layers[layer]; }), name,
    );
    button.dataset.layer = layer;
    document.getElementById("layer-toggles").append(button);
    return { layer, button };
  });
  const renderFloors = createFloorTabs(store, actions);

  store.subscribe((state) => {
    for (const { layer, button } of layers) setAttribute(button, "aria-pressed", state.layers[layer]);
    renderFloors(state);
  });
}

function createFloorTabs(store, actions) {
  const host = document.getElementById("floor-tabs");
  let shown = null;
  let tabs = [];

  function build(floors) {
    shown = floors;
    tabs = floors.map((floor) => {
      const count = element("span", { class: "count" });
      const button = toggleButton(() => actions.showFloor(floor.floor_id), floor.name, count);
      button.dataset.floorId = floor.floor_id;
      return { floor, button, count };
    });
    host.replaceChildren(...tabs.map(({ button }) => button));
  }

  return (state) => {
    if (state.floors !== shown) build(state.floors);
    const counts = countByFloor(state.people.values());
    for (const { floor, button, count } of tabs) {
      setAttribute(button, "aria-pressed", floor.floor_id === state.floorId);
      setText(count, String(counts.get(floor.floor_id) ?? 0));
    }
  };
}
