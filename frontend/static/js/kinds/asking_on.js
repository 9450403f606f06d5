// @ts-check
/** Why a few more pairs are asked: a page that is read. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

/** @param {import("../kind.js").KindPage<"asking_on">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page));
}
