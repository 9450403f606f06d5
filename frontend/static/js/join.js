// @ts-check
/** The welcome page: whether this device can show the room, said before anything is asked or stored. */

import { frameRate } from "./frame-rate.js";
import { pageData, speaker } from "./say.js";

/** The bars above and below the room, CSS pixels. */
const BARS = 160;
const SMOOTH_FROM = 15; // pictures per second: below, nobody would call it smooth
const MEASURED_TIMES = 3;
const PAUSE_MS = 700; // whatever kept the device busy may be over then

/**
 * What a study asks of a device, null where it asks nothing (backend/desirepath/study/protocol/schema.py, DeviceGate).
 * @typedef {{webgl: boolean, min_width: number | null, min_height: number | null, pointers: string[],
 *   min_frame_rate: number | null, light_below: number | null, headset: "offered" | "required" | null}} Gate
 */

const { texts, language, device } = pageData();
const gate = /** @type {Gate} */ (device);
const say = speaker(texts, language);
const form = /** @type {HTMLFormElement} */ (document.getElementById("join"));
const begin = /** @type {HTMLButtonElement} */ (document.getElementById("begin"));
const refused = /** @type {HTMLElement} */ (document.getElementById("refused"));

const touch = matchMedia("(pointer: coarse)").matches;
const mouseToo = matchMedia("(any-pointer: fine)").matches;
const webgl = hasWebGl();
/** Pictures a second; undefined while it is being measured, null where that was not possible. @type {number | null | undefined} */
let rate;

function hasWebGl() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext(); // give it back: a browser has few of them
  return context !== null;
}

/** Whether a headset can be worn here; undefined while it is asked. @type {boolean | undefined} */
let headset = gate.headset ? undefined : false;

async function findHeadset() {
  if (!gate.headset) return;
  const { xr } = /** @type {any} */ (navigator);
  headset = Boolean(await xr?.isSessionSupported("immersive-vr").catch(() => false));
  check();
}

/** @param {number} width @param {number} height */
const fits = (width, height) => width >= (gate.min_width ?? 0) && height >= (gate.min_height ?? 0);
/** What people will point with: the first that the study allows, of those that are there. */
const pointer = (touch ? ["coarse", ...(mouseToo ? ["fine"] : [])] : ["fine"]).find((kind) => gate.pointers.includes(kind));

/** @param {string} name @param {boolean} good @param {string} text */
function report(name, good, text) {
  const line = /** @type {HTMLElement} */ (document.querySelector(`[data-check="${name}"]`));
  line.dataset.result = good ? "good" : "bad";
  const words = /** @type {HTMLElement} */ (line.querySelector(".check-text"));
  if (words.textContent !== text) words.textContent = text;
}

/** @param {"webgl" | "phone" | "no_touch" | "no_mouse" | "slow" | "headset" | "no_https" | null} why */
function refuse(why) {
  const news = refused.hidden;
  refused.hidden = why === null;
  if (!why) return;
  /** @type {HTMLElement} */ (refused.querySelector("strong")).textContent = say(`refused_${why}_title`);
  /** @type {HTMLElement} */ (refused.querySelector("span")).textContent = say(`refused_${why}_do`);
  if (news) refused.scrollIntoView({ block: "nearest" });
}

function check() {
  const size = fits(innerWidth, innerHeight);
  const turned = fits(screen.height, screen.width);
  const screenFits = fits(screen.width, screen.height);
  report("webgl", webgl, say(webgl ? "webgl_good" : "webgl_bad"));
  const turn = screen.width < screen.height ? "size_turn" : "size_upright";
  report("size", size, say(size ? "size_good" : screenFits ? "size_small" : touch && turned ? turn : "size_phone"));
  const good = pointer === "coarse" ? "input_touch" : "input_mouse";
  report("input", Boolean(pointer), say(pointer ? good : touch ? "input_no_touch" : "input_no_mouse"));
  /** @param {number | null} least */
  const below = (least) => typeof rate === "number" && least !== null && rate < least;
  const fast = !below(gate.min_frame_rate);
  const lacks = gate.headset === "required" && headset === false;
  if (rate !== undefined) {
    const shown = below(gate.light_below) ? "rate_light" : below(SMOOTH_FROM) ? "rate_slow" : "rate_good";
    report("rate", fast, say(rate === null ? "rate_unknown" : !fast ? "rate_bad" : shown));
  }
  if (!webgl) refuse("webgl");
  else if (!size && !screenFits && !(touch && turned)) refuse("phone");
  else if (!pointer) refuse(touch ? "no_touch" : "no_mouse");
  else refuse(!fast ? "slow" : !lacks ? null : window.isSecureContext ? "headset" : "no_https");
  begin.disabled = !(webgl && size && pointer && rate !== undefined && fast && headset !== undefined && !lacks);
}

/** One busy second is no slow device: what would be told as slow is measured again, and the best of it counts. */
async function measure() {
  const wanted = Math.max(SMOOTH_FROM, gate.min_frame_rate ?? 0, gate.light_below ?? 0);
  /** @type {number | null} */
  let best = null;
  for (let tries = 0; webgl && tries < MEASURED_TIMES; tries += 1) {
    if (tries) await new Promise((done) => setTimeout(done, PAUSE_MS));
    const measured = await frameRate(innerWidth, Math.max(200, innerHeight - BARS));
    if (measured === null) break;
    best = Math.max(best ?? 0, measured);
    if (best >= wanted) break;
  }
  rate = best;
  check();
}

form.addEventListener("submit", () => {
  /** @type {HTMLInputElement} */ (form.elements.namedItem("device")).value = JSON.stringify({
    width: innerWidth,
    height: innerHeight,
    pixel_ratio: devicePixelRatio,
    pointer,
    touch: navigator.maxTouchPoints > 0,
    webgl,
    ...(typeof rate === "number" ? { frame_rate: Math.round(rate * 10) / 10 } : {}),
    scheme: matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light",
    reduced_motion: matchMedia("(prefers-reduced-motion: reduce)").matches,
    ...(gate.headset ? { headset } : {}),
  });
  begin.disabled = true;
});
addEventListener("resize", check);
addEventListener("pageshow", (event) => {
  if (event.persisted) location.reload(); // back from a session, perhaps: the server knows
});
check();
measure();
findHeadset();
