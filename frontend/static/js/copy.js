// @ts-check
/** Copy buttons, print buttons, and times written in the reader's own time zone. */

/** Local times below `root`. @param {ParentNode} root */
export function localTimes(root) {
  const language = document.documentElement.lang === "en" ? "en-GB" : document.documentElement.lang;
  const format = new Intl.DateTimeFormat(language, { dateStyle: "long", timeStyle: "short" });
  for (const time of /** @type {NodeListOf<HTMLTimeElement>} */ (root.querySelectorAll("time[data-local]"))) {
    time.textContent = format.format(new Date(time.dateTime));
  }
}

/**
 * Copies the text of `source`; where the browser does not allow that, selects it for the reader to copy.
 * @param {HTMLElement} source @returns {Promise<boolean>}
 */
export async function copyText(source) {
  try {
    await navigator.clipboard.writeText(source.textContent?.trim() ?? "");
    return true;
  } catch {
    getSelection()?.selectAllChildren(source);
    return false;
  }
}

document.querySelector("[data-print]")?.addEventListener("click", () => print());
localTimes(document);
