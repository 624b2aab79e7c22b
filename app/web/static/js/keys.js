// Every action by keyboard.

export function bindKeys(store, actions, map) {
  const search = document.getElementById("search");
  const list = document.getElementById("list");

  const onPage = {
    "/": () => search.focus(),
    j: () => actions.step(1),
    k: () => actions.step(-1),
    f: () => actions.fit(),
    "+": () => map.zoomIn(),
    "=": () => map.zoomIn(),
    "-": () => map.zoomOut(),
    ArrowLeft: () => map.pan(-1, 0),
    ArrowRight: () => map.pan(1, 0),
    ArrowUp: () => map.pan(0, -1),
    ArrowDown: () => map.pan(0, 1),
    Escape: () => actions.select(null),
  };
  const inList = {
    ArrowUp: () => actions.step(-1),
    ArrowDown: () => actions.step(1),
  };
  const inSearch = {
    ArrowUp: () => actions.step(-1),
    ArrowDown: () => actions.step(1),
    Enter: () => {
      actions.selectListed();
      list.focus();
    },
    Escape: () => {
      search.value = "";
      actions.search("");
      search.blur();
    },
  };

  function keysFor(target) {
    if (target === search) return inSearch;
    if (target.matches("input, select, textarea")) return {};
    return target === list ? { ...onPage, ...inList } : onPage;
  }

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return;
    if (document.querySelector("dialog[open]")) return;
    const act = keysFor(event.target)[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  search.addEventListener("input", () => actions.search(search.value));
}
