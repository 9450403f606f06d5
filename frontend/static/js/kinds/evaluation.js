// @ts-check
/** One rollout alone: watched, then on. */

import { stageNeeds } from "../kind.js";
import { SingleTrajectory } from "../single.js";

/** @param {import("../kind.js").KindPage<"evaluation">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new SingleTrajectory(bar, page.state, stageNeeds(page, "trials")) };
}
