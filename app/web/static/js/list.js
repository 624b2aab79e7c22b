// The list of people: search, counts by status, and only the rows that are in sight.

import { element, setAttribute, setText, statusMark, toggleButton } from "./dom.js";
import { metres, sinceWords, STATUS_NAMES } from "./format.js";
import { countStatuses, listed, STATUSES, statusOf } from "./people.js";
import { floorName } from "./store.js";

const ROW_PX = 36;
const ROWS_BEYOND = 4;

export function createList(store, actions, nowMs) {
  const list = document.getElementById("list");
  const empty = document.getElementById("list-empty");
  const spacer = list.appendChild(element("div", { class: "spacer", role: "presentation" }));
  const renderCounts = createCounts(store, nowMs);
  const rows = [];
  let shownSelection = null;

  function row(index) {
    if (rows[index]) return rows[index];
    const made = createRow();
    made.root.addEventListener("click", () => actions.select(made.id));
    rows[index] = made;
    spacer.append(made.root);
    return made;
  }

  function render() {
    const { state } = store;
    const now = nowMs();
    const people = listed(state, now);
    spacer.style.height = `${people.length * ROW_PX}px`;
    const first = Math.max(0, Math.floor(list.scrollTop / ROW_PX) - ROWS_BEYOND);
    const inSight = Math.ceil(list.clientHeight / ROW_PX) + 2 * ROWS_BEYOND;
    const shown = people.slice(first, first + inSight);
    shown.forEach((person, i) => fillRow(row(i), person, { state, now, position: first + i, size: people.length }));
    rows.forEach((made, i) => { made.root.hidden = i >= shown.length; });
    const selectedRow = rows.find((made) => !made.root.hidden && made.id === state.selectedId);
    if (selectedRow) list.setAttribute("aria-activedescendant", selectedRow.root.id);
    else list.removeAttribute("aria-activedescendant");
    renderEmpty(people.length);
    renderCounts();
  }

  function renderEmpty(count) {
    empty.hidden = count > 0;
    list.hidden = count === 0;
    setText(empty, emptyWords(store.state));
  }

  /** Scroll the selected row into sight, once per selection: the viewer may scroll away. */
  function revealSelection() {
    const { state } = store;
    if (state.selectedId === shownSelection) return;
    shownSelection = state.selectedId;
    const index = listed(state, nowMs()).findIndex((person) => person.id === state.selectedId);
    if (index < 0) return;
    const top = index * ROW_PX;
    if (top < list.scrollTop) list.scrollTop = top;
    else if (top + ROW_PX > list.scrollTop + list.clientHeight) list.scrollTop = top + ROW_PX - list.clientHeight;
  }

  list.addEventListener("scroll", render, { passive: true });
  new ResizeObserver(render).observe(list);
  store.subscribe(() => {
    revealSelection();
    render();
  });
  return { render };
}

function emptyWords(state) {
  if (state.people.size) return "Nobody matches.";
  if (state.connection !== "live") return "";
  if (state.siteId === null) return "This server has no site yet. Import one with “pharos import”.";
  return "No phone has reported yet.";
}

let rowCount = 0;

function createRow() {
  const mark = statusMark("offline");
  const name = element("span", { class: "name" });
  const where = element("span", { class: "where" });
  const extent = element("span", { class: "extent" });
  const who = element("span", { class: "who" }, name, where);
  rowCount += 1;
  const root = element("div", { class: "row", role: "option", id: `row-${rowCount}` }, mark, who, extent);
  return { root, mark, name, where, extent, id: null };
}

function fillRow(row, person, { state, now, position, size }) {
  const status = statusOf(person, now);
  row.id = person.id;
  row.root.style.top = `${position * ROW_PX}px`;
  setAttribute(row.root, "data-device-id", person.id);
  setAttribute(row.root, "aria-selected", person.id === state.selectedId);
  setAttribute(row.root, "aria-posinset", position + 1);
  setAttribute(row.root, "aria-setsize", size);
  setAttribute(row.mark, "data-status", status);
  setText(row.name, person.name);
  setText(row.where, person.fix ? placeWords(state, person.fix) : "—");
  setText(row.extent, status === "live" ? `±${metres(person.fix.radius95_m)}` : sinceWords(person.seenMs, now));
  setAttribute(row.root, "aria-label", `${person.name}, ${STATUS_NAMES[status]}, ${row.where.textContent}`);
}

function placeWords(state, fix) {
  return [floorName(state, fix.floor_id), ...(fix.zones ?? [])].join(" · ");
}

function createCounts(store, nowMs) {
  const host = document.getElementById("counts");
  const buttons = STATUSES.map((status) => {
    const count = element("span", { class: "count" });
    const label = element("span", { class: "label" }, statusMark(status), STATUS_NAMES[status]);
    const button = toggleButton(
      () => store.change((state) => { state.onlyStatus = state.onlyStatus === status ? null : status; }),
      label, count,
    );
    button.dataset.status = status;
    host.append(button);
    return { status, button, count };
  });
  return () => {
    const counts = countStatuses(store.state.people.values(), nowMs());
    for (const { status, button, count } of buttons) {
      setText(count, String(counts[status]));
      setAttribute(button, "aria-pressed", store.state.onlyStatus === status);
    }
  };
}
