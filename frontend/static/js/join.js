// @ts-check
/** The welcome page: whether this device can show the room, told before anything is asked or stored. */

import { pageData, speaker } from "./say.js";

/** Smaller windows cannot show the room and the bars together; checked against the shorter and the longer side. */
const SHORT_SIDE = 500;
const LONG_SIDE = 740;

const { texts, language } = pageData();
const say = speaker(texts, language);
const form = /** @type {HTMLFormElement} */ (document.getElementById("join"));
const begin = /** @type {HTMLButtonElement} */ (document.getElementById("begin"));
const refused = /** @type {HTMLElement} */ (document.getElementById("refused"));

const touch = matchMedia("(pointer: coarse)").matches;
const webgl = hasWebGl();

function hasWebGl() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext(); // give it back: a browser has few of them
  return context !== null;
}

/** @param {number} width @param {number} height */
const fits = (width, height) => Math.min(width, height) >= SHORT_SIDE && width >= LONG_SIDE;

/** @param {string} name @param {boolean} good @param {string} text */
function report(name, good, text) {
  const line = /** @type {HTMLElement} */ (document.querySelector(`[data-check="${name}"]`));
  line.dataset.result = good ? "good" : "bad";
  const words = /** @type {HTMLElement} */ (line.querySelector(".check-text"));
  if (words.textContent !== text) words.textContent = text;
}

/** @param {"webgl" | "phone" | null} why */
function refuse(why) {
  refused.hidden = why === null;
  if (!why) return;
  const [title, what] = refused.querySelectorAll("p");
  /** @type {HTMLElement} */ (title.querySelector("strong")).textContent = say(`refused_${why}_title`);
  what.textContent = say(`refused_${why}_do`);
}

function check() {
  const size = fits(innerWidth, innerHeight);
  const turned = fits(screen.height, screen.width);
  const screenFits = fits(screen.width, screen.height);
  report("webgl", webgl, say(webgl ? "webgl_good" : "webgl_bad"));
  report("size", size, say(size ? "size_good" : screenFits ? "size_small" : touch && turned ? "size_turn" : "size_phone"));
  report("input", true, say(touch ? "input_touch" : "input_mouse"));
  refuse(!webgl ? "webgl" : !size && !screenFits && !(touch && turned) ? "phone" : null);
  begin.disabled = !(webgl && size);
}

form.addEventListener("submit", () => {
  /** @type {HTMLInputElement} */ (form.elements.namedItem("device")).value = JSON.stringify({
    width: innerWidth,
    height: innerHeight,
    pixel_ratio: devicePixelRatio,
    pointer: touch ? "coarse" : "fine",
    touch: navigator.maxTouchPoints > 0,
    webgl,
    scheme: matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light",
    reduced_motion: matchMedia("(prefers-reduced-motion: reduce)").matches,
  });
  begin.disabled = true;
});
addEventListener("resize", check);
addEventListener("pageshow", check); // also when coming back to the page
check();
