// @ts-check
/** Questions that are asked only after certain answers: shows and hides them. The server decides the same way. */

/** @typedef {{ item: string, is?: string, is_not?: string, one_of?: string[], at_least?: number, at_most?: number }} Fitting */

/** The questions of `scope` that are asked. @param {HTMLElement} scope @returns {HTMLElement[]} */
export const askedOf = (scope) => [.../** @type {NodeListOf<HTMLElement>} */ (scope.querySelectorAll("[data-item]"))].filter((item) => !item.hidden);

/**
 * Shows the questions whose conditions fit the answers before them, and hides the others; what these hold counts as not
 * answered.
 *
 * @param {HTMLElement} form
 * @param {(item: HTMLElement) => unknown} answerOf
 */
export function showAsked(form, answerOf) {
  /** @type {Record<string, unknown>} */
  const answers = {};
  for (const item of /** @type {NodeListOf<HTMLElement>} */ (form.querySelectorAll("[data-item]"))) {
    if (item.dataset.when) {
      const conditions = /** @type {Fitting[]} */ (JSON.parse(item.dataset.when));
      item.hidden = !conditions.every((one) => fits(one, answers[one.item] ?? null));
    }
    if (!item.hidden) answers[item.dataset.item ?? ""] = answerOf(item);
  }
}

/** As `Fitting.fits` in backend/desirepath/grammar/when.py. @param {Fitting} when @param {unknown} given */
function fits(when, given) {
  const { is, is_not, one_of, at_least, at_most } = when;
  if (given === null) return is_not !== undefined && [is, one_of, at_least, at_most].every((test) => test === undefined);
  const word = String(given);
  const number = typeof given === "number" ? given : Number.NaN;
  return (
    (is === undefined || word === is) &&
    (is_not === undefined || word !== is_not) &&
    (one_of === undefined || one_of.includes(word)) &&
    (at_least === undefined || number >= at_least) &&
    (at_most === undefined || number <= at_most)
  );
}
