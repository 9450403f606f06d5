// @ts-check
/** The preference weights by hand, the robot's way redrawn at once. */

import { stageNeeds } from "../kind.js";
import { LivePanel } from "../live.js";

/** @param {import("../kind.js").KindPage<"tuning">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept } = page;
  return { bar: new LivePanel(panel, { ...stageNeeds(page, "live"), tell, language, keep, kept }) };
}
