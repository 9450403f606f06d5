// @ts-check
/** A page that says which letter to press. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"attention">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
