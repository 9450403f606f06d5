// @ts-check
/** Which robot came from the own answers. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"guess">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
