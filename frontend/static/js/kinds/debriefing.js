// @ts-check
/** The last page, with the completion code. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

export const longText = true;
export const last = true;

/** @param {import("../kind.js").KindPage<"debriefing">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
