// @ts-check
/** Questions with right answers: a form as any other; the server says what is right. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"comprehension">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
