// Small ways to make elements and to change only what differs.

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

export function setAttribute(target, name, value) {
  if (target.getAttribute(name) !== String(value)) target.setAttribute(name, value);
}

/** A button that is pressed or not. */
export function toggleButton(onClick, ...children) {
  const button = element("button", { type: "button", "aria-pressed": "false" }, ...children);
  button.addEventListener("click", onClick);
  return button;
}

export function statusMark(status) {
  return element("span", { class: "mark", "data-status": status, "aria-hidden": "true" });
}
