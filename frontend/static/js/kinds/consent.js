// @ts-check
/** Consent: points to tick one by one, and purposes that are agreed to or not. */

import { formNeeds } from "../kind.js";
import { readyForm } from "../questions.js";

export const longText = true;

/** @param {import("../kind.js").KindPage} page */
export function mount(page) {
  readyForm(page.step, formNeeds(page), (form, collected) => {
    const purposes = Object.entries(collected).map(([key, said]) => [key, said === "yes"]);
    const asked = purposes.length ? { purposes: Object.fromEntries(purposes) } : {};
    return { given: true, version: new FormData(form).get("version"), ...asked };
  });
}
