// @ts-check
/** Consent: points to tick one by one, and purposes that are agreed to or not. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

export const longText = true;

/** @param {import("../kind.js").KindPage<"consent">} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page), (form, collected) => {
    const purposes = Object.entries(collected).map(([key, answer]) => [key, answer === "yes"]);
    const asked = purposes.length ? { purposes: Object.fromEntries(purposes) } : {};
    /** @type {import("../types.js").AnswerTo<"consent">} */
    const agreed = { given: true, version: String(new FormData(form).get("version")), ...asked };
    return agreed;
  });
}
