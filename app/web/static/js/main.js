// The Live screen, put together.

import { createActions } from "./actions.js";
import { serverNowMs } from "./api.js";
import { createDetail } from "./detail.js";
import { createHeader } from "./header.js";
import { bindKeys } from "./keys.js";
import { createList } from "./list.js";
import { Live } from "./live.js";
import { loginWithLink } from "./login.js";
import { FloorMap } from "./map.js";
import { PeopleLayer } from "./people-layer.js";
import { bindPointer } from "./pointer.js";
import { createStore, initialState } from "./store.js";
import { createToolbar } from "./toolbar.js";
import { publishView } from "./view.js";

const AGES_MS = 1_000;

const clocks = { wallMs: serverNowMs, pageMs: () => performance.now() };
const reducedMotion = window.matchMedia("(prefers-reduced-motion: reduce)").matches;

const store = createStore(initialState());
const map = new FloorMap(reducedMotion);
const actions = createActions(store, map, clocks.wallMs);
const layer = new PeopleLayer(map, store, clocks, reducedMotion);
const live = new Live(store, actions, clocks);

createHeader(store, (siteId) => live.showSite(siteId));
createList(store, actions, clocks.wallMs);
createDetail(store, actions, clocks.wallMs);
createToolbar(store, actions);
bindKeys(store, actions, map);
bindPointer(store, actions, map, layer);
publishView(store, map, layer);

// Ages grow and people turn stale without anything arriving.
setInterval(() => store.change(() => {}), AGES_MS);

await loginWithLink();
await live.start();
