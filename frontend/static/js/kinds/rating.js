// @ts-check
/** One trajectory alone, then a number on the protocol's own scale: buttons, or a slider that must be moved first. */

import { stageNeeds } from "../kind.js";
import { SingleTrajectory } from "../single.js";

class RatedTrajectory extends SingleTrajectory {
  /**
   * @param {HTMLElement} root the bar
   * @param {import("../types.js").ProgressOf<"rating">} state
   * @param {import("../stage-bar.js").StageNeeds} needs
   */
  constructor(root, state, needs) {
    super(root, state, needs);
    /** @type {number | null} */
    this.rating = null;
    root.querySelectorAll("[data-rating]").forEach((given) =>
      given.addEventListener("input", () => {
        this.rating = Number(/** @type {HTMLInputElement} */ (given).value);
        this.goOn.setAttribute("aria-disabled", "false");
      }),
    );
  }

  async next() {
    if (this.busy || this.state.phase !== "choosing") return;
    if (this.rating === null) {
      this.needs.announce(this.root.querySelector("#rating-open")?.textContent ?? "");
      return;
    }
    /** @type {import("../types.js").AnswerTo<"rating">} */
    const value = { rating: this.rating };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"rating">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new RatedTrajectory(bar, page.state, stageNeeds(page, "trials")) };
}
