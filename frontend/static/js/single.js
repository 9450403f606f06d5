// @ts-check
/** The bar of a trajectory that is shown alone: Watch, the trajectory, Continue. Everything else is as in a trial of two. */

import { Trial } from "./trial.js";

export class SingleTrajectory extends Trial {
  /**
   * @param {HTMLElement} root the bar
   * @param {import("./types.js").TrialState} state
   * @param {import("./stage-bar.js").StageNeeds} needs
   */
  constructor(root, state, needs) {
    super(root, state, needs);
    this.goOn = /** @type {HTMLButtonElement} */ (root.querySelector("[data-go-on]"));
    this.goOn.addEventListener("click", () => this.next());
  }

  async next() {
    if (this.busy || this.state.phase !== "choosing") return;
    await this.decide({});
  }

  /** Draws the phase; the words stand in the template. */
  show() {
    const { phase } = this.state;
    const changed = phase !== this.shown;
    this.shown = phase;
    if (phase === "ready") {
      this.part("ready");
      this.start.setAttribute("aria-disabled", String(!this.stageReady || this.needs.headset.missing !== null));
      if (changed || document.activeElement === document.body) this.start.focus({ preventScroll: true });
    } else if (phase === "playing_a") {
      this.part("playing");
      if (changed) {
        this.rewind("#playing-progress");
        this.needs.announce(this.root.querySelector("#playing-text")?.textContent ?? "");
      }
    } else if (phase === "choosing") {
      this.part("choosing");
      if (changed) {
        window.focus(); // takes the keyboard back from the stage
        /** @type {HTMLElement | null} */ (this.root.querySelector("[data-go-on]"))?.focus({ preventScroll: true });
      }
    } else {
      this.part("sending");
    }
  }
}
