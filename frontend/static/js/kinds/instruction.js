// @ts-check
/** A page that says what to do next. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

export const longText = true;

/** @param {import("../kind.js").KindPage<"instruction">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
