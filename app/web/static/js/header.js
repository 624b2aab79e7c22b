// The bar: which site, whether the stream is alive, light or dark.

import { element, setAttribute, setText } from "./dom.js";
import { toggleTheme } from "./theme.js";

const CONNECTION_WORDS = { connecting: "Connecting", live: "Live", reconnecting: "Reconnecting", failed: "Not connected" };

export function createHeader(store, onSite) {
  const name = document.getElementById("site-name");
  const select = document.getElementById("site-select");
  const connection = document.getElementById("connection");
  let shownSites = null;

  select.addEventListener("change", () => {
    onSite(select.value);
    select.blur();
  });
  document.getElementById("theme-toggle").addEventListener("click", toggleTheme);

  store.subscribe((state) => {
    const site = state.sites.find((each) => each.site_id === state.siteId);
    setText(name, site?.name ?? "Pharos");
    name.hidden = state.sites.length > 1;
    select.hidden = state.sites.length <= 1;
    if (state.sites !== shownSites) {
      shownSites = state.sites;
      select.replaceChildren(...shownSites.map((each) => element("option", { value: each.site_id }, each.name)));
    }
    select.value = state.siteId ?? "";
    setText(connection, state.problem || CONNECTION_WORDS[state.connection]);
    setAttribute(connection, "data-state", state.connection);
  });
}
