// @ts-check
/** Items, one block per screen. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"questionnaire">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
