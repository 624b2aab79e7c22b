// The calls of /v1 that the page makes. The session cookie travels by itself.

export class ApiError extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

/** Nobody answered: the server or the way to it is gone, perhaps for a moment. */
export class ServerLostError extends Error {
  constructor() {
    super("The server does not answer.");
  }
}

let serverOffsetMs = 0;

/** The server's wall clock, to the second: ages must not depend on the viewer's clock. */
export function serverNowMs() {
  return Date.now() + serverOffsetMs;
}

export async function login(token) {
  await request("/v1/login", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ token }),
  });
}

export const sites = () => listAll("/v1/sites");
export const floors = (siteId) => listAll("/v1/floors", { site_id: siteId });
export const beacons = (siteId) => listAll("/v1/beacons", { site_id: siteId });
export const devices = () => listAll("/v1/devices");

export function streamUrl(location) {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/stream`;
}

async function listAll(path, query = {}) {
  const items = [];
  let cursor = null;
  do {
    const search = new URLSearchParams({ ...query, limit: 500, ...(cursor && { cursor }) });
    const page = await request(`${path}?${search}`);
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor);
  return items;
}

async function request(path, options = {}) {
  const { response, body } = await exchange(path, options);
  const date = Date.parse(response.headers.get("Date"));
  if (!Number.isNaN(date)) serverOffsetMs = date - Date.now();
  if (!response.ok) throw new ApiError(response.status, problemWords(response, body));
  return body ? JSON.parse(body) : null;
}

async function exchange(path, options) {
  try {
    const response = await fetch(path, { credentials: "same-origin", ...options });
    return { response, body: await response.text() };
  } catch {
    throw new ServerLostError();
  }
}

function problemWords(response, body) {
  const isProblem = response.headers.get("Content-Type")?.startsWith("application/problem+json");
  if (!isProblem) return `${response.status} ${response.statusText}`;
  const { detail, title } = JSON.parse(body);
  return detail ?? title;
}
