// @ts-check
/** The waiting step: an honest bar from the job's own progress. It never runs backwards and never runs by itself. */

/**
 * @param {HTMLElement} step
 * @param {(key: string, values?: Record<string, string | number>) => string} say
 * @returns {(job: {progress?: number | null, state?: string, done?: boolean}) => void} to be told of the job
 */
export function readyWait(step, say) {
  const bar = /** @type {HTMLProgressElement} */ (step.querySelector("#wait-progress"));
  const now = /** @type {HTMLElement} */ (step.querySelector("#wait-now"));
  const share = /** @type {HTMLElement} */ (step.querySelector("#wait-share"));
  let furthest = 0;
  return (job) => {
    if (typeof job.progress !== "number") return;
    furthest = Math.max(furthest, Math.min(1, job.progress));
    const percent = Math.floor(furthest * 100);
    bar.value = percent;
    share.textContent = say("share", { percent });
    const words = furthest > 0 && !job.done ? (now.dataset.running ?? "") : say(job.done ? "wait.done" : "wait.queued");
    if (now.textContent !== words) now.textContent = words;
  };
}
