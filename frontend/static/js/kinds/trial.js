// @ts-check
/** Two trajectories of one query, then the choice. */

import { stageNeeds } from "../kind.js";
import { Trial } from "../trial.js";

/** @param {import("../kind.js").KindPage<"trial">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new Trial(bar, page.state, stageNeeds(page, "trials")) };
}
