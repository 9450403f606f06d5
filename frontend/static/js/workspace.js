// @ts-check
// The workspace of one policy: what belongs to its picture and takes longer comes while the picture is looked at.

import { localTimes } from "./lab.js";

const SOON_MS = 6000;

/** The stage stands there, or takes long: then nothing waits for it any more. */
const seen = new Promise((resolve) => {
  addEventListener("message", (event) => {
    if (event.data?.source === "desirepath-stage" && event.data.type === "ready") resolve(null);
  });
  setTimeout(resolve, SOON_MS);
});

/** Fetch each part of the page that is marked with data-part="ADDRESS"; whoever makes something of it hears `part`. */
for (const part of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-part]"))) {
  void seen.then(async () => {
    const response = await fetch(part.dataset.part ?? "", { headers: { "X-Fragment": "1" } });
    if (response.redirected || response.status === 401) return window.location.reload();
    part.innerHTML = await response.text();
    part.removeAttribute("aria-busy");
    localTimes(part);
    part.dispatchEvent(new CustomEvent("part", { bubbles: true }));
  });
}
