// @ts-check
/** Waiting while something is learned: an honest bar from the job's own progress. */

import { readyWait } from "../wait.js";

/** @param {import("../kind.js").KindPage<"wait">} page @returns {import("../kind.js").Mounted} */
export function mount({ step, say }) {
  return { job: readyWait(step, say) };
}
