// Light or dark: the system's choice, until the viewer makes their own.

const KEY = "pharos.theme";
const systemDark = window.matchMedia("(prefers-color-scheme: dark)");

const COLOURS = [
  "text", "muted", "live", "stale", "offline", "beacon", "halo", "accent",
];

function apply(choice) {
  if (choice === null) delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = choice;
}

export function toggleTheme() {
  const system = systemDark.matches ? "dark" : "light";
  const current = document.documentElement.dataset.theme ?? system;
  const next = current === "dark" ? "light" : "dark";
  if (next === system) localStorage.removeItem(KEY);
  else localStorage.setItem(KEY, next);
  apply(next === system ? null : next);
}

export function onThemeChange(listener) {
  systemDark.addEventListener("change", listener);
  new MutationObserver(listener).observe(document.documentElement, { attributeFilter: ["data-theme"] });
}

/** The colours as a canvas takes them: a canvas knows no CSS variables. */
export function themeColours() {
  const probe = document.body.appendChild(document.createElement("i"));
  const colours = {};
  for (const name of COLOURS) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  return colours;
}

apply(localStorage.getItem(KEY));
