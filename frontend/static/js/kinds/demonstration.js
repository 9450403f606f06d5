// @ts-check
/** Drawing a path on the floor. */

import { Drawing } from "../drawing.js";
import { stageNeeds } from "../kind.js";

/** @param {import("../kind.js").KindPage<"demonstration">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#drawing"));
  const { tell, toStage, language } = page;
  return { bar: new Drawing(bar, page.state, { ...stageNeeds(page, "drawing"), tell, toStage, language }) };
}
