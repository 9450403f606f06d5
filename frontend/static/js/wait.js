// @ts-check
/** The waiting step: who is before, about how long still, and a bar of the whole wait, which never runs backwards. */

const MINUTE_S = 60;
const MINUTES_FROM_S = 100; // below, a minute more or less would be a jump

/**
 * @param {HTMLElement} step
 * @param {(key: string, values?: Record<string, string | number>) => string} say
 * @returns {(job: Partial<import("./contract.js").JobNews>) => void} to be told of the job
 */
export function readyWait(step, say) {
  const bar = /** @type {HTMLProgressElement} */ (step.querySelector("#wait-progress"));
  const now = /** @type {HTMLElement} */ (step.querySelector("#wait-now"));
  const left = /** @type {HTMLElement} */ (step.querySelector("#wait-left"));
  const latest = /** @type {HTMLElement} */ (step.querySelector("#wait-latest"));
  let furthest = 0;
  /** @param {string} what @param {number} seconds */
  const inTime = (what, seconds) =>
    seconds < MINUTES_FROM_S
      ? say(`wait.${what}_seconds`, { count: seconds })
      : say(`wait.${what}_minutes`, { count: Math.round(seconds / MINUTE_S) });
  return ({ progress, before = 0, running = false, seconds, at_most, done = false }) => {
    if (typeof progress !== "number") return;
    furthest = Math.max(furthest, Math.min(1, progress));
    bar.value = Math.floor(furthest * 100);
    let words = say("wait.queued");
    if (done) words = say("wait.done");
    else if (running) words = now.dataset.running ?? "";
    else if (seconds === null) words = say("wait.silent");
    else if (before > 0) words = say("wait.before", { count: before });
    const most = typeof at_most === "number" ? at_most : null;
    const expected = typeof seconds === "number" && (most === null || seconds <= most) ? seconds : null;
    write(now, words);
    write(left, done || expected === null ? "" : inTime("left", expected));
    write(latest, done || most === null ? "" : inTime("latest", most));
  };
}

/** @param {HTMLElement} where @param {string} words */
function write(where, words) {
  if (where.textContent !== words) where.textContent = words;
}
