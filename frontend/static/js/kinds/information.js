// @ts-check
/** A page of text. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

export const longText = true;

/** @param {import("../kind.js").KindPage<"information">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
