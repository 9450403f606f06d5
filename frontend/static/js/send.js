// @ts-check
/** Sends to the server until it has answered: lost connections are waited out, refusals are thrown. */

/** The server understood and said no. */
export class Refused extends Error {
  /**
   * @param {number} status
   * @param {Partial<import("./contract.js").Trouble>} error
   */
  constructor(status, error) {
    super(error.message ?? `refused (${status})`);
    this.status = status;
    this.code = error.code ?? "";
    this.field = error.field ?? "";
  }
}

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 8000;
const PATIENCE_MS = 15000;

/** @typedef {"connection" | "server" | "full" | null} Waiting for what a request has to wait; null: it went through */

/** Told whenever a request has to wait, and when none does any more. @type {(waiting: Waiting) => void} */
let onWaiting = () => {};

/** For what each request waits that has to, in the order in which they began to. @type {Map<symbol, Waiting>} */
const waits = new Map();

/** @param {(waiting: Waiting) => void} listener */
export function watchConnection(listener) {
  onWaiting = listener;
}

/** A random name for one request; `crypto.randomUUID` is missing on plain http addresses. */
export function newRequestId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** @param {number} ms */
export const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/**
 * One request, tried until the server acknowledged or refused it. The body stays the same, its `request_id` too, so
 * that the server counts it once however often it arrives.
 *
 * @param {string} url
 * @param {object} [body] POST where given
 * @returns {Promise<any>} the JSON answered
 */
export async function ask(url, body) {
  const response = await persist(url, body);
  if (response.status === 204) return {};
  return response.json();
}

/** A page or fragment as text, tried the same way. @param {string} url @returns {Promise<string>} */
export async function fetchText(url) {
  return (await persist(url)).text();
}

/** @param {string} url @param {object} [body] @returns {Promise<Response>} */
async function persist(url, body) {
  let wait = FIRST_WAIT_MS;
  const mine = Symbol(url);
  for (;;) {
    /** @type {Response | null} */
    let response = null;
    try {
      response = await fetch(url, {
        method: body ? "POST" : "GET",
        headers: body ? { "Content-Type": "application/json" } : {},
        body: body ? JSON.stringify(body) : undefined,
        cache: "no-store",
        signal: AbortSignal.timeout(PATIENCE_MS),
      });
    } catch {
      response = null; // no connection, or too long without an answer
    }
    // 429 and 5xx pass by themselves: an overloaded or restarting server is waited for like a lost connection
    if (response && response.status !== 429 && response.status < 500) {
      if (waits.delete(mine)) onWaiting([...waits.values()].at(-1) ?? null); // another one may still wait
      if (response.ok) return response;
      const answer = await response.json().catch(() => ({}));
      throw new Refused(response.status, answer.error ?? {});
    }
    const why = response?.status === 507 ? "full" : response?.status === 503 || response?.status === 429 ? "server" : "connection";
    if (why !== waits.get(mine)) {
      waits.set(mine, why);
      onWaiting(why);
    }
    const asked = Number(response?.headers.get("Retry-After") ?? 0) * 1000 || 0;
    await Promise.race([pause(Math.max(wait, asked)), new Promise((done) => addEventListener("online", done, { once: true }))]);
    wait = Math.min(wait * 2, LONGEST_WAIT_MS);
  }
}
