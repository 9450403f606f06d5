// @ts-check
// The workspace of one policy: what belongs to its picture and takes longer comes while the picture is looked at.

import { localTimes } from "./lab.js";

/** Fetch each part of the page that is marked with data-part="ADDRESS"; whoever makes something of it hears `part`. */
for (const part of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-part]"))) {
  void fetch(part.dataset.part ?? "", { headers: { "X-Fragment": "1" } }).then(async (response) => {
    if (response.redirected || response.status === 401) return window.location.reload();
    part.innerHTML = await response.text();
    part.removeAttribute("aria-busy");
    localTimes(part);
    part.dispatchEvent(new CustomEvent("part", { bubbles: true }));
  });
}
