// @ts-check
/** A rest: its button rests as long as the protocol says. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"break">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
