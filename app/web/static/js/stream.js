// The live stream: one socket at a time, opened again after every loss, in step by its snapshot.

const PROTOCOL = "pharos.v1";
const SUBSCRIPTION = "s1";
const FIRST_DELAY_MS = 500;
const LONGEST_DELAY_MS = 8_000;
const PING_MS = 10_000;
const SILENCE_MS = 30_000;

/** Wait before attempt n (0, 1, ...): doubling, the upper half of it left to chance. */
export function backoffDelayMs(attempt, random) {
  const ceiling = Math.min(LONGEST_DELAY_MS, FIRST_DELAY_MS * 2 ** attempt);
  return ceiling * (0.5 + random / 2);
}

/** A subscription that is kept alive from `start()` to `stop()`. */
export class LiveStream {
  #url;
  #handlers;
  #stopped = false;
  #attempt = 0;
  #socket = null;
  #refusal = ""; // the server's words when it refused the subscription
  #wake = () => {};

  /**
   * handlers:
   *   prepare      async, before each attempt: load what may have changed; returns the filter of
   *                the subscription, or throws
   *   isPassing    tells whether an error of `prepare` is worth another attempt
   *   onSnapshot, onEvent      take the items of a frame
   *   onConnection("live" | "reconnecting" | "failed", problem)
   */
  constructor(url, handlers) {
    this.#url = url;
    this.#handlers = handlers;
  }

  async start() {
    const wake = () => this.#wake();
    window.addEventListener("online", wake);
    try {
      while (!this.#stopped) await this.#attemptOnce();
    } finally {
      window.removeEventListener("online", wake);
    }
  }

  stop() {
    this.#stopped = true;
    this.#socket?.close();
    this.#wake();
  }

  async #attemptOnce() {
    try {
      const filter = await this.#handlers.prepare();
      if (!this.#stopped) await this.#converse(filter);
    } catch (error) {
      if (!this.#handlers.isPassing(error)) {
        this.#handlers.onConnection("failed", error.message);
        throw error;
      }
    }
    if (this.#stopped) return;
    this.#handlers.onConnection("reconnecting", this.#refusal);
    await this.#pause(backoffDelayMs(this.#attempt, Math.random()));
    this.#attempt += 1;
  }

  /** One socket from its opening to its end, whatever ends it. */
  async #converse(filter) {
    const socket = new WebSocket(this.#url, PROTOCOL);
    this.#socket = socket;
    const send = (frame) => socket.send(JSON.stringify(frame));
    let heardMs = performance.now();
    const pulse = setInterval(() => {
      if (performance.now() - heardMs > SILENCE_MS) socket.close();
      else if (socket.readyState === WebSocket.OPEN) send({ op: "ping" });
    }, PING_MS);
    socket.onopen = () => send({ op: "subscribe", id: SUBSCRIPTION, topic: "fixes", filter });
    socket.onmessage = (message) => {
      heardMs = performance.now();
      if (!this.#stopped) this.#receive(JSON.parse(message.data));
    };
    const closed = await new Promise((resolve) => { socket.onclose = resolve; });
    clearInterval(pulse);
    if (closed.code >= 4400) this.#refusal = closed.reason;
  }

  #receive(frame) {
    if (frame.op === "subscribed") {
      this.#attempt = 0;
      this.#refusal = "";
      this.#handlers.onSnapshot(frame.snapshot);
      this.#handlers.onConnection("live", "");
    } else if (frame.op === "event") {
      this.#handlers.onEvent(frame.data);
    } else if (frame.op === "error") {
      this.#refusal = frame.detail;
      this.#socket.close();
    }
  }

  #pause(delayMs) {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, delayMs);
      this.#wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}
