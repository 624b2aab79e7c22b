// What is known of the selected person.

import { element, setAttribute, setText, statusMark, toggleButton } from "./dom.js";
import {
  methodWords, metres, motionWords, noFixWords, sinceWords, STATUS_NAMES, usedWords,
} from "./format.js";
import { statusOf } from "./people.js";
import { floorName } from "./store.js";

/** Label and words of each line; `null` words leave the line out. */
function factsOf(state, person, nowMs) {
  const { fix } = person;
  const seen = ["Last seen", sinceWords(person.seenMs, nowMs)];
  if (fix === null) return [seen];
  return [
    seen,
    ["Floor", floorName(state, fix.floor_id)],
    ["Floor certainty", `${Math.round(fix.floor_confidence * 100)} %`],
    ["Position", `${fix.x.toFixed(1)}, ${fix.y.toFixed(1)} m`],
    ["95 % radius", metres(fix.radius95_m)],
    ["Motion", motionWords(fix)],
    ["Method", methodWords(fix)],
    ["Profile", fix.profile],
    ["Used", usedWords(fix.used)],
    ["Readings", `${fix.age_s.toFixed(1)} s old`],
    ["Zones", fix.zones?.length ? fix.zones.join(", ") : null],
  ].filter(([, words]) => words !== null);
}

export function createDetail(store, actions, nowMs) {
  const host = document.getElementById("detail");
  const nobody = element("p", { class: "nobody" }, "Nobody selected");
  const mark = statusMark("offline");
  const name = element("span", { id: "detail-name" });
  const sub = element("p", { class: "person-sub" });
  const noFix = element("p", { class: "no-fix", id: "detail-no-fix" });
  const facts = element("dl", { class: "facts", id: "detail-facts" });
  const follow = toggleButton(() => actions.follow(!store.state.following), "Follow");
  follow.id = "follow";
  const centre = element("button", { type: "button" }, "Centre");
  centre.addEventListener("click", () => actions.centre());
  const card = element(
    "div", {},
    element("div", { class: "person-head" }, mark, name), sub, noFix, facts,
    element("div", { class: "actions" }, follow, centre),
  );
  host.append(nobody, card);

  function render() {
    const { state } = store;
    const person = state.people.get(state.selectedId);
    nobody.hidden = person !== undefined;
    card.hidden = person === undefined;
    if (person === undefined) return;
    const now = nowMs();
    const status = statusOf(person, now);
    setAttribute(mark, "data-status", status);
    setText(name, person.name);
    setText(sub, person.name === person.id ? STATUS_NAMES[status] : `${STATUS_NAMES[status]} · ${person.id}`);
    noFix.hidden = person.noFixReason === null;
    setText(noFix, person.noFixReason === null ? "" : `No position now. ${noFixWords(person.noFixReason)}`);
    fillFacts(facts, factsOf(state, person, now));
    setAttribute(follow, "aria-pressed", state.following);
    follow.disabled = centre.disabled = person.fix === null;
  }

  store.subscribe(render);
  return { render };
}

function fillFacts(list, lines) {
  while (list.children.length > 2 * lines.length) list.lastChild.remove();
  while (list.children.length < 2 * lines.length) list.append(element("dt"), element("dd"));
  lines.forEach(([label, words], i) => {
    setText(list.children[2 * i], label);
    setText(list.children[2 * i + 1], words);
  });
}
