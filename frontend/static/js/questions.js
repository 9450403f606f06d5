// @ts-check
/** Forms of a step: one block of questions per screen, gentle pointing-out, what was ticked so far kept for a reload. */

import { ranked, readyRanking, rerank } from "./ranking.js";
import { askedOf, showAsked } from "./skipping.js";

/** The last seconds of a time limit are said one by one, before that the full minutes. */
const SAID_S = 60;

/**
 * @template {object} [A=any] what the kind answers
 * @typedef {object} FormNeeds
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(value: A) => Promise<void>} answer
 * @property {(values: Record<string, unknown>) => void} keep
 * @property {Record<string, unknown> | null} kept
 */

/**
 * Readies the form of `#step`.
 *
 * @template {object} A
 * @param {HTMLElement} step
 * @param {FormNeeds<A>} needs
 * @param {(form: HTMLFormElement, collected: Record<string, unknown>) => A} [made] the answer, where
 *   it is not simply what was filled in
 */
export function readyForm(step, needs, made = (_, collected) => /** @type {A} */ (collected)) {
  const form = /** @type {HTMLFormElement | null} */ (step.querySelector("#step-form"));
  if (!form) return;
  const blocks = /** @type {HTMLElement[]} */ ([...form.querySelectorAll("[data-block]")]);
  const back = /** @type {HTMLButtonElement | null} */ (step.querySelector("[data-back]"));
  let shown = 0;
  let busy = false;

  // resting until here: pressed before the scripts have come, it would only load the page again
  restFor(step, form, needs);
  if (needs.kept) fill(form, needs.kept);
  showAsked(form, answerOf);
  if (form.dataset.limit) limitTo(step, Number(form.dataset.limit), needs, () => collect(form)); // may be over already
  if (blocks.length && !askedOf(blocks[0]).length && near(1) > 0) turn(near(1));
  tellPage();
  for (const item of rankings(form)) readyRanking(item, needs.say);
  form.addEventListener("input", (event) => {
    const item = event.target instanceof Element ? event.target.closest("[data-item]") : null;
    showAsked(form, answerOf);
    tellPage();
    if (item) point(item, null);
    if (item && !form.querySelector("[data-missing]")) count(0);
    hide(step.querySelector("#points-open"));
    const orders = rankings(form).filter((one) => !one.hidden);
    needs.keep({ ...collect(form), ...Object.fromEntries(orders.map((one) => [one.dataset.item, ranked(one)])) });
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!busy) next();
  });
  back?.addEventListener("click", () => turn(near(-1)));

  /** The next screen in that direction on which something is asked, -1 where there is none. @param {1 | -1} way */
  function near(way) {
    for (let at = shown + way; at >= 0 && at < blocks.length; at += way) if (askedOf(blocks[at]).length) return at;
    return -1;
  }

  /** Which screen of how many that will really come. */
  function tellPage() {
    const page = step.querySelector("#page-count");
    const coming = blocks.filter((block) => askedOf(block).length);
    if (page) page.textContent = coming.length > 1 ? needs.say("page", { index: coming.indexOf(blocks[shown]) + 1, total: coming.length }) : "";
  }

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
    const following = near(1);
    if (following > 0) {
      turn(following);
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
    if (back) back.hidden = near(-1) < 0;
    tellPage();
    count(0);
    scrollTo(0, 0);
    /** @type {HTMLElement | null} */ (step.querySelector("h1"))?.focus({ preventScroll: true });
  }

  /** @param {number} open */
  function count(open) {
    const place = step.querySelector("#open-count");
    if (place) place.textContent = open ? needs.say("open", { count: open }) : "";
  }

  function value() {
    const filled = /** @type {HTMLFormElement} */ (form);
    return made(filled, collect(filled));
  }
}

/** The button of a break rests as long as the server says, which began to count on arrival. @param {HTMLElement} step @param {HTMLElement} form @param {FormNeeds} needs */
function restFor(step, form, needs) {
  const button = step.querySelector(".bottombar .main");
  const left = step.querySelector("#rest-left");
  const words = left?.textContent ?? "";
  const until = performance.now() + Number(form.dataset.atLeast ?? 0) * 1000;
  const look = () => {
    const seconds = Math.ceil((until - performance.now()) / 1000);
    if (!form.isConnected) return;
    if (left) left.textContent = seconds > 0 ? needs.say("rest_left", { count: seconds }) : words;
    if (seconds > 0) setTimeout(look, 1000);
    else button?.removeAttribute("disabled");
  };
  look();
}

/**
 * A page with a time limit: says how much is left by the server's clock, and sends what there is when it is over.
 * @param {HTMLElement} step @param {number} seconds @param {FormNeeds} needs @param {() => Record<string, unknown>} collected
 */
function limitTo(step, seconds, needs, collected) {
  const place = step.querySelector("#time-left");
  const until = performance.now() + seconds * 1000;
  const look = () => {
    if (!place?.isConnected) return;
    const left = Math.ceil((until - performance.now()) / 1000);
    if (left <= 0) void needs.answer({ ...collected(), timed_out: true });
    else {
      if (left <= SAID_S || left % 60 === 0) place.textContent = needs.say("time_left", { minutes: Math.floor(left / 60), seconds: left % 60 });
      setTimeout(look, 1000);
    }
  };
  look();
}

/** The items of `scope` that still want an answer, pointed out. @param {HTMLElement} scope @param {FormNeeds["say"]} say */
function check(scope, say) {
  return askedOf(scope).filter((item) => {
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
  for (const item of askedOf(form)) {
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
