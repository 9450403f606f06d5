// @ts-check
/** Forms of a step: one block of questions per screen, gentle pointing-out, what was ticked so far kept for a reload. */

import { ranked, readyRanking, rerank } from "./ranking.js";

/**
 * @typedef {object} FormNeeds
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(value: Record<string, unknown>) => Promise<void>} answer
 * @property {(values: Record<string, unknown>) => void} keep
 * @property {Record<string, unknown> | null} kept
 */

/**
 * Readies the form of `#step`: information, instruction, consent, questionnaire or guess.
 *
 * @param {HTMLElement} step
 * @param {string} kind
 * @param {FormNeeds} needs
 */
export function readyForm(step, kind, needs) {
  const form = /** @type {HTMLFormElement | null} */ (step.querySelector("#step-form"));
  if (!form) return;
  const blocks = /** @type {HTMLElement[]} */ ([...form.querySelectorAll("[data-block]")]);
  const back = /** @type {HTMLButtonElement | null} */ (step.querySelector("[data-back]"));
  let shown = 0;
  let busy = false;

  // resting until here: pressed before the scripts have come, it would only load the page again
  step.querySelector(".bottombar .main")?.removeAttribute("disabled");
  if (needs.kept) fill(form, needs.kept);
  for (const item of rankings(form)) readyRanking(item, needs.say);
  form.addEventListener("input", (event) => {
    const item = event.target instanceof Element ? event.target.closest("[data-item]") : null;
    if (item) point(item, null);
    if (item && !form.querySelector("[data-missing]")) count(0);
    hide(step.querySelector("#points-open"));
    needs.keep({ ...collect(form), ...Object.fromEntries(rankings(form).map((one) => [one.dataset.item, ranked(one)])) });
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!busy) next();
  });
  back?.addEventListener("click", () => turn(shown - 1));

  async function next() {
    const points = /** @type {HTMLInputElement[]} */ ([.../** @type {HTMLElement} */ (form).querySelectorAll("[data-point]")]);
    const unticked = points.find((box) => !box.checked);
    if (unticked) {
      /** @type {HTMLElement} */ (step.querySelector("#points-open")).hidden = false;
      unticked.focus();
      return;
    }
    const scope = blocks[shown] ?? form;
    const wrong = check(scope, needs.say);
    count(wrong.length);
    if (wrong.length) {
      /** @type {HTMLElement | null} */ (wrong[0].querySelector("input, textarea, [data-pool] button"))?.focus();
      wrong[0].scrollIntoView({ block: "nearest" });
      return;
    }
    if (shown < blocks.length - 1) {
      turn(shown + 1);
      return;
    }
    busy = true;
    step.querySelector(".bottombar .main")?.setAttribute("aria-disabled", "true");
    try {
      await needs.answer(value());
    } finally {
      busy = false;
      step.querySelector(".bottombar .main")?.removeAttribute("aria-disabled");
    }
  }

  /** @param {number} to block to show */
  function turn(to) {
    blocks[shown].hidden = true;
    shown = to;
    blocks[shown].hidden = false;
    if (back) back.hidden = shown === 0;
    const page = step.querySelector("#page-count");
    if (page) page.textContent = needs.say("page", { index: shown + 1, total: blocks.length });
    count(0);
    scrollTo(0, 0);
    /** @type {HTMLElement | null} */ (step.querySelector("h1"))?.focus({ preventScroll: true });
  }

  /** @param {number} open */
  function count(open) {
    const place = step.querySelector("#open-count");
    if (place) place.textContent = open ? needs.say("open", { count: open }) : "";
  }

  /** @returns {Record<string, unknown>} */
  function value() {
    if (kind === "consent") return { given: true, version: new FormData(/** @type {HTMLFormElement} */ (form)).get("version") };
    return collect(/** @type {HTMLFormElement} */ (form));
  }
}

/** The items of `scope` that still want an answer, pointed out. @param {HTMLElement} scope @param {FormNeeds["say"]} say */
function check(scope, say) {
  const items = /** @type {HTMLElement[]} */ ([...scope.querySelectorAll("[data-item]")]);
  return items.filter((item) => {
    const answer = answerOf(item);
    let wrong = null;
    if (answer === null) {
      wrong = item.dataset.required === "true" ? say("open_item") : null;
    } else if (item.dataset.type === "number") {
      const input = /** @type {HTMLInputElement} */ (item.querySelector("input"));
      if (!input.checkValidity() || !Number.isInteger(answer)) {
        wrong = say("out_of_range", { min: input.min || "0", max: input.max || "…" });
      }
    }
    point(item, wrong);
    return wrong !== null;
  });
}

/** @param {Element} item @param {string | null} problem */
function point(item, problem) {
  const words = /** @type {HTMLElement | null} */ (item.querySelector(".gentle"));
  item.toggleAttribute("data-missing", problem !== null);
  if (!words) return;
  words.hidden = problem === null;
  if (problem) words.textContent = problem;
}

/** @param {HTMLElement} scope @returns {HTMLElement[]} */
const rankings = (scope) => [...scope.querySelectorAll(/** @type {"div"} */ ("[data-type=ranking]"))];

/** @param {HTMLElement} item @returns {string | number | (string | null)[] | null} */
function answerOf(item) {
  if (item.dataset.type === "ranking") return ranked(item).includes(null) ? null : ranked(item);
  if (item.dataset.type === "scale" || item.dataset.type === "choice") {
    const chosen = /** @type {HTMLInputElement | null} */ (item.querySelector("input:checked"));
    if (!chosen) return null;
    return item.dataset.type === "scale" ? Number(chosen.value) : chosen.value;
  }
  const field = /** @type {HTMLInputElement | HTMLTextAreaElement} */ (item.querySelector("input, textarea"));
  const text = field.value.trim();
  if (item.dataset.type === "number") {
    // what is typed but is no number (validity.badInput) reads as an empty value: an answer, and a wrong one
    if (field.validity.badInput) return Number.NaN;
    return text === "" ? null : Number(text);
  }
  return text === "" ? null : text;
}

/** What has been answered so far, by item. @param {HTMLFormElement} form @returns {Record<string, unknown>} */
function collect(form) {
  /** @type {Record<string, unknown>} */
  const values = {};
  for (const item of /** @type {NodeListOf<HTMLElement>} */ (form.querySelectorAll("[data-item]"))) {
    const answer = answerOf(item);
    if (answer !== null) values[item.dataset.item ?? ""] = answer;
  }
  return values;
}

/** @param {HTMLFormElement} form @param {Record<string, unknown>} values */
function fill(form, values) {
  for (const item of /** @type {NodeListOf<HTMLElement>} */ (form.querySelectorAll("[data-item]"))) {
    const value = values[item.dataset.item ?? ""];
    if (value === undefined || value === null) continue;
    if (item.dataset.type === "ranking") rerank(item, value);
    const radio = /** @type {HTMLInputElement | undefined} */ (
      [...item.querySelectorAll("input[type=radio]")].find((input) => /** @type {HTMLInputElement} */ (input).value === String(value))
    );
    const field = /** @type {HTMLInputElement | null} */ (item.querySelector("input[type=number], textarea"));
    if (radio) radio.checked = true;
    else if (field) field.value = String(value);
  }
}

/** @param {Element | null} element */
function hide(element) {
  if (element instanceof HTMLElement) element.hidden = true;
}
