// @ts-check
/** Tells the server's log what happened in this browser, with the browser's own time. Nobody waits for it. */

/** @typedef {import("./contract.js").Noticed} Noticed */

/**
 * @param {string} api address of the session
 * @returns {(kind: Noticed["kind"], data?: Noticed["data"]) => void}
 */
export function noticer(api) {
  return (kind, data = {}) => {
    fetch(`${api}/events`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ kind, data, client_time: new Date().toISOString() }),
      keepalive: true,
    }).catch(() => {}); // a note that cannot be delivered is not worth disturbing anybody
  };
}
