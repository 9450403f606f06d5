// @ts-check
/**
 * Controls for preference weights: what they stand at, and every change with its time, place and hand. Sliders, of
 * which two weights that exclude each other are the two ends, or a triangle of three (triangle.js). What a change means
 * is told to whoever listens.
 */

import { Triangle } from "./triangle.js";

/** @typedef {{[objective: string]: number}} Weights objective to weight, only those above 0 */
/** @typedef {import("./contract.js").Change} Change */

const MOST_CHANGES = 2300;
/** Positions of a slider under the hand that follow each other so quickly are one change. */
const ONE_CHANGE_S = 0.04;
/** Of a triangle, each of whose changes is one of up to three weights. */
const ONE_PULL_S = 0.1;

export class Controls {
  /**
   * @param {HTMLElement} root with an input[data-ends] per slider: its objectives, the left end first
   * @param {Weights} start
   * @param {object} listening
   * @param {() => number} listening.place in which place it is tried now
   * @param {(objective: string) => void} listening.moved a weight was changed
   * @param {() => void} listening.settled the hand has let go
   */
  constructor(root, start, { place, moved, settled }) {
    this.root = root;
    this.start = start;
    this.place = place;
    this.moved = moved;
    /** @type {Weights} */
    this.weights = { ...start };
    /** @type {Change[]} */
    this.history = [];
    this.opened = performance.now();
    /** @type {Change["by"]} */
    this.by = "mouse";
    this.sliders = /** @type {HTMLInputElement[]} */ ([...root.querySelectorAll("input[data-ends]")]);
    const triangle = /** @type {HTMLElement | null} */ (root.querySelector("[data-triangle]"));
    /** @type {Triangle | null} */
    this.triangle = null;
    root.addEventListener("byheadset", () => (this.by = "headset"), { capture: true });
    for (const type of ["pointerdown", "keydown"]) {
      root.addEventListener(
        type,
        (event) => {
          this.by = event instanceof PointerEvent ? hand(event.pointerType) : "keys";
        },
        { capture: true },
      );
    }
    if (triangle) {
      this.triangle = new Triangle(triangle, { moved: (weights) => this.pulled(weights, this.by), settled });
      if (!Object.keys(start).length) this.weights = this.triangle.put(start);
    }
    for (const slider of this.sliders) {
      slider.addEventListener("input", () => this.slid(slider));
      slider.addEventListener("change", settled);
    }
    this.show();
  }

  /** What was changed before the page was loaded anew. @param {Record<string, unknown> | null} kept */
  restore(kept) {
    if (!kept || !Array.isArray(kept.history)) return;
    this.weights = /** @type {Weights} */ (kept.weights);
    this.history = /** @type {Change[]} */ (kept.history);
    this.opened = performance.now() - 1000 * (this.history[this.history.length - 1]?.seconds ?? 0);
    this.show();
  }

  /** @param {HTMLInputElement} slider */
  ends(slider) {
    return (slider.dataset.ends ?? "").split(" ");
  }

  /** @param {HTMLInputElement} slider */
  slid(slider) {
    const value = Number(slider.value) / 100;
    const ends = this.ends(slider);
    const objective = ends.length === 1 ? ends[0] : value < 0 ? ends[0] : value > 0 ? ends[1] : this.of(ends) ?? ends[1];
    this.set(objective, Math.abs(value), this.by);
    this.say(slider);
  }

  /** The triangle stands elsewhere. @param {Weights} to @param {Change["by"]} by */
  pulled(to, by) {
    const names = this.triangle?.names ?? [];
    const changed = names.filter((one) => (this.weights[one] ?? 0) !== (to[one] ?? 0));
    if (!changed.length) return;
    const now = Math.round(performance.now() - this.opened) / 1000;
    const last = this.history[this.history.length - 1];
    const same = last && now - last.seconds < ONE_PULL_S && names.includes(last.objective) && last.by === by;
    const seconds = same ? last.seconds : now;
    for (const objective of changed) {
      if (to[objective] > 0) this.weights[objective] = to[objective];
      else delete this.weights[objective];
      const known = this.history.findIndex((one) => one.seconds === seconds && one.objective === objective);
      if (same && known >= 0) this.history.splice(known, 1);
      this.history.push({ seconds, place: this.place(), by, objective, weight: to[objective] ?? 0 });
      if (this.history.length > MOST_CHANGES) this.forget();
    }
    this.moved(changed[0]);
  }

  /** Which of these weighs something now. @param {string[]} ends */
  of(ends) {
    return ends.find((one) => this.weights[one] > 0);
  }

  /** @param {string} objective @param {number} weight @param {Change["by"]} by */
  set(objective, weight, by) {
    if ((this.weights[objective] ?? 0) === weight) return;
    for (const slider of this.sliders) {
      const ends = this.ends(slider);
      if (ends.includes(objective)) for (const one of ends) delete this.weights[one];
    }
    if (weight > 0) this.weights[objective] = weight;
    const seconds = Math.round(performance.now() - this.opened) / 1000;
    const last = this.history[this.history.length - 1];
    // of each moment the last position, noted at the moment's beginning, so that a long drag is many changes
    const same = last && last.objective === objective && seconds - last.seconds < ONE_CHANGE_S;
    if (same) this.history.pop();
    this.history.push({ seconds: same ? last.seconds : seconds, place: this.place(), by, objective, weight });
    if (this.history.length > MOST_CHANGES) this.forget();
    this.moved(objective);
  }

  /** The oldest change that a later one of the same weight has outdated. */
  forget() {
    const outdated = this.history.findIndex((one, i) => this.history.slice(i + 1).some((later) => later.objective === one.objective));
    if (outdated >= 0) this.history.splice(outdated, 1);
  }

  /** All of them at once. @param {Weights} to @param {Change["by"]} by */
  put(to, by) {
    if (this.triangle) this.pulled(this.triangle.put(to), by);
    for (const slider of this.sliders) {
      const ends = this.ends(slider);
      const wanted = ends.find((one) => to[one] > 0);
      if (wanted) this.set(wanted, to[wanted], by);
      else {
        const now = this.of(ends);
        if (now) this.set(now, 0, by);
      }
    }
    this.show();
  }

  show() {
    if (this.triangle) this.triangle.put(this.weights);
    for (const slider of this.sliders) {
      const ends = this.ends(slider);
      const one = this.of(ends);
      const value = one ? this.weights[one] * 100 : 0;
      slider.value = String(Math.round(one === ends[0] && ends.length === 2 ? -value : value));
      this.say(slider);
    }
  }

  /** How a slider stands, for screen readers and for the eye. @param {HTMLInputElement} slider */
  say(slider) {
    const row = /** @type {HTMLElement} */ (slider.closest("[data-control]"));
    const one = this.of(this.ends(slider));
    const words = one ? row.querySelector(`[data-end="${one}"] [data-name]`)?.textContent : row.dataset.none;
    slider.setAttribute("aria-valuetext", one ? `${words}: ${Math.round(this.weights[one] * 100)}` : (words ?? ""));
    for (const end of /** @type {NodeListOf<HTMLElement>} */ (row.querySelectorAll("[data-end]"))) {
      end.toggleAttribute("data-on", end.dataset.end === one);
    }
  }

  /** What is sent as the answer. */
  answer() {
    return { weights: this.weights, history: this.history };
  }
}

/** @param {string} pointer @returns {Change["by"]} */
function hand(pointer) {
  return pointer === "touch" || pointer === "pen" ? pointer : "mouse";
}
