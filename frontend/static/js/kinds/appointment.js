// @ts-check
/** When and how to come back. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"appointment">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
