// The live stream: one socket at a time, opened again after every loss, in step by its snapshot.

const PROTOCOL = "pharos.v1";
const SUBSCRIPTION = "s1";
const FIRST_DELAY_MS = 500;
const LONGEST_DELAY_MS = 15_000;
const PING_MS = 20_000;
const SILENCE_MS = 30_000;

/** Wait before attempt n (0, 1, ...): doubling, the upper half of it left to chance. */
export function backoffDelayMs(attempt, random) {
  const ceiling = Math.min(LONGEST_DELAY_MS, FIRST_DELAY_MS * 2 ** attempt);
  return ceiling * (0.5 + random / 2);
}

/**
 * Keep a subscription alive until `stop()`.
 *
 * prepare     async, before each attempt: load what may have changed; returns the subscription's
 *             filter, or throws; an error that `isPassing` knows is worth another attempt
 * onSnapshot, onEvent   receive the list of items of a frame
 * onConnection("live" | "reconnecting" | "failed", problem)
 */
export function keepSubscribed({ url, prepare, isPassing, onSnapshot, onEvent, onConnection }) {
  let stopped = false;
  let attempt = 0;
  let socket = null;
  let refusal = ""; // the server's words when it refused the subscription
  let wake = () => {};

  async function run() {
    while (!stopped) {
      try {
        const filter = await prepare();
        if (!stopped) await converse(filter);
      } catch (error) {
        if (!isPassing(error)) {
          onConnection("failed", error.message);
          throw error;
        }
      }
      if (stopped) return;
      onConnection("reconnecting", refusal);
      await pause(backoffDelayMs(attempt, Math.random()));
      attempt += 1;
    }
  }

  function pause(delayMs) {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, delayMs);
      wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }

  function receive(frame) {
    if (frame.op === "subscribed") {
      attempt = 0;
      refusal = "";
      onSnapshot(frame.snapshot);
      onConnection("live", "");
    } else if (frame.op === "event") {
      onEvent(frame.data);
    } else if (frame.op === "error") {
      refusal = frame.detail;
      socket.close();
    }
  }

  /** One socket from opening to its end, whatever ends it. */
  function converse(filter) {
    return new Promise((resolve) => {
      socket = new WebSocket(url, PROTOCOL);
      const current = socket;
      let heardMs = performance.now();
      const pulse = setInterval(() => {
        if (performance.now() - heardMs > SILENCE_MS) current.close();
        else if (current.readyState === WebSocket.OPEN) send({ op: "ping" });
      }, PING_MS / 2);
      const send = (frame) => current.send(JSON.stringify(frame));
      current.onopen = () => send({ op: "subscribe", id: SUBSCRIPTION, topic: "fixes", filter });
      current.onmessage = (message) => {
        heardMs = performance.now();
        if (!stopped) receive(JSON.parse(message.data));
      };
      current.onclose = () => {
        clearInterval(pulse);
        resolve();
      };
    });
  }

  const onOnline = () => wake();
  window.addEventListener("online", onOnline);
  run();
  return {
    stop() {
      stopped = true;
      window.removeEventListener("online", onOnline);
      socket?.close();
      wake();
    },
  };
}
