// @ts-check
/** After an answer: how the robot would drive now. It drives by itself, once; whoever has seen enough goes on. */

import { stageNeeds } from "../kind.js";
import { LivePanel } from "../live.js";

class Feedback extends LivePanel {
  /** @param {HTMLElement} root @param {ConstructorParameters<typeof LivePanel>[1]} needs */
  constructor(root, needs) {
    super(root, needs);
    this.watched = false;
    this.droveOnce = false;
    this.opened = performance.now();
  }

  get asked() {
    return null;
  }

  /** @param {import("../contract.js").LivePaths} reply @param {boolean} onward @param {number[] | null} since */
  draw(reply, onward, since) {
    super.draw(reply, onward, since);
    if (this.droveOnce) return;
    this.droveOnce = true;
    this.drive();
  }

  stood() {
    this.watched = true;
    super.stood();
  }

  async done() {
    const seconds = Math.round(performance.now() - this.opened) / 1000;
    /** @type {import("../types.js").AnswerTo<"feedback">} */
    const value = { watched: this.watched, seconds };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"feedback">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept } = page;
  return { bar: new Feedback(panel, { ...stageNeeds(page, "live"), tell, language, keep, kept }) };
}
