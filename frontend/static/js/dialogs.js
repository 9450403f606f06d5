// @ts-check
/**
 * Opening, turning and closing the page's dialogs; native `<dialog>` keeps the focus inside and gives it back. A dialog
 * tells with the event `opened` that it now lies over the page. Whatever is pressed in a menu closes it, which gives the
 * focus back to the button that opened it.
 */

export function readyDialogs() {
  document.addEventListener("click", (event) => {
    const target = event.target instanceof Element ? event.target.closest("button") : null;
    if (!target) return;
    /** @type {HTMLElement | null} */ (target.closest(":popover-open"))?.hidePopover();
    if (target.dataset.opens) {
      const dialog = /** @type {HTMLDialogElement} */ (document.getElementById(target.dataset.opens));
      dialog.showModal();
      turn(dialog, target.dataset.pageTo ?? "choose");
      dialog.dispatchEvent(new CustomEvent("opened", { bubbles: true }));
    } else if ("closes" in target.dataset) {
      target.closest("dialog")?.close();
    } else if (target.dataset.turn) {
      const dialog = target.closest("dialog");
      if (dialog) turn(dialog, target.dataset.turn);
    }
  });
}

/** @param {HTMLDialogElement} dialog @param {string} name of the page inside it */
function turn(dialog, name) {
  const pages = /** @type {NodeListOf<HTMLElement>} */ (dialog.querySelectorAll("[data-page]"));
  for (const page of pages) {
    page.hidden = page.dataset.page !== name;
  }
  // the heading first, so that a screen reader begins with what this is about
  /** @type {HTMLElement | null} */ (dialog.querySelector("[data-page]:not([hidden]) h2, :scope > h2"))?.focus();
}
