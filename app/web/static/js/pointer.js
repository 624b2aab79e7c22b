// Mouse and finger on the map: point at somebody to read the name, click to select.

export function bindPointer(store, actions, map, layer) {
  const container = map.leaflet.getContainer();

  function hover(id) {
    if (id === store.state.hoveredId) return;
    store.change((state) => { state.hoveredId = id; });
    container.classList.toggle("over-person", id !== null);
  }

  map.leaflet.on("mousemove", (event) => hover(layer.at(event.containerPoint.x, event.containerPoint.y)));
  map.leaflet.on("mouseout", () => hover(null));
  map.leaflet.on("click", (event) => actions.select(layer.at(event.containerPoint.x, event.containerPoint.y)));
  map.leaflet.on("dragstart", () => store.change((state) => { state.following = false; }));
}
