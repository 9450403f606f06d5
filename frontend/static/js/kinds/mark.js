// @ts-check
/**
 * One drive, in which moments are marked by a button or key while it plays; then, for each, what it was, by choice. Times
 * count from the robot's first move; of a drive that has to begin again nothing stays.
 */

import { stageNeeds } from "../kind.js";
import { speaker } from "../say.js";
import { SingleTrajectory } from "../single.js";

/** @typedef {import("../contract.js").SentMark & {good: boolean}} Mark good: by which button it was made */

const APART_S = 0.4; // a press so soon after another one is the same

class MarkedTrajectory extends SingleTrajectory {
  /**
   * @param {HTMLElement} root the bar
   * @param {import("../kind.js").KindPage<"mark">} page
   */
  constructor(root, page) {
    super(root, page.state, stageNeeds(page, "trials"));
    this.tell = page.tell;
    this.keep = page.keep;
    this.own = speaker(JSON.parse(document.getElementById("mark-words")?.textContent ?? "{}"), page.language);
    this.most = Number(root.dataset.most ?? 1);
    /** @type {HTMLButtonElement[]} */
    this.taps = [...root.querySelectorAll(/** @type {"button"} */ ("[data-mark]"))];
    /** @type {HTMLButtonElement[]} */
    this.reasons = [...root.querySelectorAll(/** @type {"button"} */ ("[data-why]"))];
    this.list = /** @type {HTMLElement} */ (root.querySelector("[data-marks]"));
    this.ticks = /** @type {HTMLElement} */ (root.querySelector("[data-ticks]"));
    this.removeButton = /** @type {HTMLButtonElement} */ (root.querySelector("[data-remove]"));
    const said = JSON.parse(root.dataset.said ?? "{}");
    this.fixed = "marks" in said;
    /** Which playing of the drive was seen in this tab, by its restarts. @type {unknown} */
    this.saw = page.kept?.saw ?? null;
    const kept = this.state.phase === "choosing" && this.seen ? /** @type {Mark[]} */ (page.kept?.marks) : null;
    /** @type {Mark[]} */
    this.marks = said.marks ?? kept ?? [];
    /** Which one is asked about. */
    this.held = 0;
    /** When the robot began to move, by the page's clock; null: it does not. @type {number | null} */
    this.since = null;
    /** When something was marked last, likewise. */
    this.tapped = -Infinity;
    for (const button of this.taps) button.addEventListener("click", (event) => this.tap(button.dataset.mark === "good", event.timeStamp));
    for (const button of this.reasons) button.addEventListener("click", () => this.give(/** @type {Mark["why"]} */ (button.dataset.why ?? null)));
    this.removeButton.addEventListener("click", () => this.remove());
    this.draw();
    this.show();
  }

  // ---- while it plays ----------------------------------------------------------------------------------------------

  run() {
    super.run();
    if (this.fixed) return;
    this.since = performance.now();
    this.saw = this.state.restarts ?? 0;
    this.marks = [];
    this.note();
    this.held = 0;
    this.draw();
    this.show();
  }

  /** @param {boolean} good @param {number} [now] by the page's clock */
  tap(good, now = performance.now()) {
    if (this.since === null || this.state.phase !== "playing_a") {
      if (!this.fixed) this.needs.announce(this.own("not_yet"));
      return;
    }
    if (now - this.tapped < 1000 * APART_S) return;
    if (this.marks.length >= this.most) {
      this.needs.announce(this.own("most", { count: this.most }));
      return;
    }
    this.tapped = now;
    const at = Math.min(Math.max(0, (now - this.since) / 1000), this.state.duration_a_s);
    this.marks.push({ at_s: Number(at.toFixed(2)), why: good ? "good" : null, good });
    this.note();
    this.draw();
    this.needs.announce(this.own("marked", { count: this.marks.length }));
  }

  // ---- what it was -------------------------------------------------------------------------------------------------

  get choosing() {
    return this.state.phase === "choosing" && !this.busy && !this.fixed && this.seen;
  }

  /** Whether what was marked in the drive can be known here. */
  get seen() {
    return this.fixed || this.saw === (this.state.restarts ?? 0);
  }

  /** Survives a reload of this tab. */
  note() {
    this.keep({ marks: this.marks, saw: this.saw });
  }

  /** The drive was watched elsewhere: its marks are lost, so it starts over. */
  async startOver() {
    if (this.cutting || this.over) return;
    this.cutting = true;
    try {
      await this.work(async () => (this.state.phase === "choosing" && !this.seen ? this.needs.post("interrupted", { reason: "unseen" }) : undefined));
    } finally {
      this.cutting = false;
    }
  }

  /** @param {number} number from 0 */
  hold(number) {
    this.held = number;
    this.draw();
    this.look();
    this.needs.announce(this.name(number));
  }

  /** Shows the room as it was when the mark was made. */
  look() {
    const mark = this.marks[this.held];
    if (mark && this.state.phase === "choosing") this.tell({ type: "still", seconds: mark.at_s });
  }

  /** @param {Mark["why"]} why taken back where it was said already: then it is what it was pressed for */
  give(why) {
    const mark = this.marks[this.held];
    if (!this.choosing || !mark) return;
    mark.why = mark.why !== why ? why : mark.good ? "good" : null;
    this.note();
    this.needs.announce(this.name(this.held));
    const open = this.marks.findIndex((one, k) => k > this.held && !one.why);
    if (mark.why && open >= 0) {
      this.held = open;
      this.look();
    }
    this.draw();
  }

  remove() {
    if (!this.choosing || !this.marks.length) return;
    const number = this.held + 1;
    this.marks.splice(this.held, 1);
    this.held = Math.max(0, Math.min(this.held, this.marks.length - 1));
    this.note();
    this.draw();
    this.look();
    this.needs.announce(this.own("removed", { number }));
    if (!this.marks.length) this.goOn.focus({ preventScroll: true });
  }

  /** @param {number} number from 0 */
  name(number) {
    const { at_s: at, why } = this.marks[number];
    const said = this.reasons.find((button) => button.dataset.why === why)?.dataset.name;
    const place = { number: number + 1, seconds: Number(at.toFixed(1)) };
    return said ? this.own("named", { ...place, said }) : this.own("named_open", place);
  }

  draw() {
    const of = this.state.duration_a_s || 1;
    const tick = (/** @type {Mark} */ { at_s: at, why }) => {
      const spot = document.createElement("i");
      spot.style.left = `${Math.min(100, (100 * at) / of)}%`;
      spot.toggleAttribute("data-good", why === "good");
      return spot;
    };
    this.ticks.replaceChildren(...this.marks.map(tick));
    const full = this.marks.length >= this.most && this.own("most", { count: this.most });
    this.text("#mark-count", full || (this.marks.length ? this.own("marked", { count: this.marks.length }) : ""));
    const buttons = this.marks.map((mark, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.held = String(k);
      button.setAttribute("aria-pressed", String(k === this.held));
      button.setAttribute("aria-label", this.name(k));
      const badge = document.createElement("b");
      badge.textContent = mark.why === "good" ? "✓" : mark.why ? "✗" : "?";
      button.append(badge, ` ${mark.at_s.toLocaleString(document.documentElement.lang || undefined, { maximumFractionDigits: 1, minimumFractionDigits: 1 })} s`);
      button.addEventListener("click", () => this.hold(k));
      const item = document.createElement("li");
      item.append(button);
      return item;
    });
    const refocus = this.list.contains(document.activeElement);
    this.list.replaceChildren(...buttons);
    if (refocus) /** @type {HTMLElement | null} */ (this.list.querySelector(`[data-held="${this.held}"]`))?.focus({ preventScroll: true });
    for (const part of this.root.querySelectorAll("[data-some]")) part.toggleAttribute("hidden", !this.marks.length);
    for (const button of this.reasons) button.setAttribute("aria-pressed", String(Boolean(this.marks[this.held]?.why) && button.dataset.why === this.marks[this.held].why));
    const question = this.marks.length > 1 ? this.own("what_of", { number: this.held + 1, of: this.marks.length }) : this.own("what");
    this.text("#question", this.marks.length ? question : this.own("nothing"));
  }

  show() {
    const { phase } = this.state;
    const changed = phase !== this.shown;
    super.show();
    if (!this.marks) return; // while the bar is being made
    // the stage's news can come before the answer that says what is playing
    const starting = phase === "ready" && this.busy;
    if (phase !== "playing_a" && !starting) this.since = null;
    if (phase === "playing_a") {
      this.part("marking");
      if (changed) this.taps[0]?.focus({ preventScroll: true });
    } else if (phase === "ready" && !this.fixed && !starting) {
      this.marks = [];
      this.saw = null;
      this.note();
    } else if (phase === "choosing" && !this.seen) {
      this.part("sending");
      void this.startOver();
    } else if (phase === "choosing" && changed) {
      this.draw();
      this.look();
      /** @type {HTMLElement | null} */ (this.root.querySelector("#question"))?.focus({ preventScroll: true });
      this.needs.announce(this.root.querySelector("#question")?.textContent ?? "");
    }
    for (const button of this.taps) button.setAttribute("aria-disabled", String(this.since === null && phase === "playing_a"));
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const onButton = event.target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter");
    if (event.repeat && this.state.phase === "playing_a") event.preventDefault(); // a key that is held down marks once
    else if (!onButton) super.key(event);
  }

  /** Pressed here or while the stage had the focus. @param {string} key @returns {boolean} */
  press(key) {
    if (this.state.phase === "playing_a") {
      const found = this.taps.find((button) => button.dataset.key === key) ?? (key === " " ? this.taps[0] : undefined);
      if (found) this.tap(found.dataset.mark === "good");
      return Boolean(found);
    }
    if (!this.choosing) return false;
    const said = this.reasons.find((button) => button.dataset.key === key);
    if (said) this.give(/** @type {Mark["why"]} */ (said.dataset.why ?? null));
    return Boolean(said);
  }

  async next() {
    if (this.busy || this.state.phase !== "choosing" || !this.seen) return;
    /** @type {import("../types.js").AnswerTo<"mark">} */
    const value = { marks: this.marks.map(({ at_s: at, why }) => ({ at_s: at, why })) };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"mark">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new MarkedTrajectory(bar, page) };
}
