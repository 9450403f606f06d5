// @ts-check
/**
 * Several drives, one after the other, then all in order, the best one, or piles. The ways and their numbers lie on the
 * stage; which one the robot drives is said from here, and the answer is kept here until it is sent.
 */

import { stageNeeds } from "../kind.js";
import { speaker } from "../say.js";
import { StageBar } from "../stage-bar.js";

/** @typedef {import("../stage-frame.js").StageMessage & {over?: boolean}} StageMessage */

const BETWEEN_MS = 700;

/** @extends {StageBar<import("../types.js").ProgressOf<"order">>} */
class Order extends StageBar {
  /**
   * @param {HTMLElement} root the bar
   * @param {import("../kind.js").KindPage<"order">} page
   */
  constructor(root, page) {
    super(root, page.state, stageNeeds(page, "trials"));
    this.tell = page.tell;
    this.keep = page.keep;
    this.own = speaker(JSON.parse(document.getElementById("order-words")?.textContent ?? "{}"), page.language);
    this.ask = root.dataset.ask ?? "order";
    /** @type {number[]} */
    this.durations = JSON.parse(root.dataset.durations ?? "[]");
    this.start = /** @type {HTMLButtonElement} */ (root.querySelector("#start"));
    this.goOn = /** @type {HTMLButtonElement} */ (root.querySelector("[data-go-on]"));
    this.undoButton = /** @type {HTMLButtonElement | null} */ (root.querySelector("[data-undo]"));
    /** @type {HTMLButtonElement[]} */
    this.drives = [...root.querySelectorAll(/** @type {"button"} */ ("[data-drive]"))];
    /** @type {HTMLButtonElement[]} */
    this.piles = [...root.querySelectorAll(/** @type {"button"} */ ("[data-pile]"))];
    const said = JSON.parse(root.dataset.said ?? "{}");
    this.fixed = "ask" in said;
    /** What stands already, the best first. @type {number[]} */
    this.ranking = said.order ?? /** @type {number[]} */ (page.kept?.ranking) ?? [];
    /** Drive -> its pile. @type {Record<number, number>} */
    this.inPile = said.groups
      ? Object.fromEntries(said.groups.flatMap((/** @type {number[]} */ pile, /** @type {number} */ k) => pile.map((n) => [n, k])))
      : /** @type {Record<number, number>} */ (page.kept?.inPile) ?? {};
    /** The drive that a pile is meant for. */
    this.held = 1;
    /** How many were watched to their ends, in turn. */
    this.seen = this.fixed ? this.drives.length : Number(page.kept?.seen ?? 0);
    /** Which one plays now. @type {number | null} */
    this.plays = null;
    this.start.addEventListener("click", () => this.goThrough());
    this.goOn.addEventListener("click", () => void this.next());
    this.undoButton?.addEventListener("click", () => this.undo());
    for (const button of this.drives) button.addEventListener("click", () => this.pick(Number(button.dataset.drive)));
    for (const button of root.querySelectorAll("[data-play]")) {
      button.addEventListener("click", () => this.play(Number(button.getAttribute("data-play"))));
    }
    for (const button of this.piles) button.addEventListener("click", () => this.put(Number(button.dataset.pile)));
    this.drives.forEach((button, i) => button.style.setProperty("--drive", this.colour(i)));
    this.draw();
    this.begin();
  }

  get playing() {
    return false; // the server does not know what plays: it checks the time that the page stood
  }

  get choosing() {
    return this.seen >= this.drives.length && this.plays === null;
  }

  // ---- watching ----------------------------------------------------------------------------------------------------

  /** The next one that was not watched, until all were. */
  goThrough() {
    if (!this.stageReady || this.needs.headset.missing !== null || this.plays !== null) return;
    if (this.seen < this.drives.length) this.play(this.seen + 1);
  }

  /** @param {number} number */
  play(number) {
    if (!this.stageReady || this.busy) return;
    this.plays = number;
    this.show();
    this.rewind("#playing-progress");
    this.follow("#playing-progress", this.durations[number - 1]);
    this.needs.announce(this.own("playing", { number }));
    this.tell({ type: "steer", do: "drive", only: number - 1 });
  }

  /** What plays is seen by nobody: it begins again when it is wanted. */
  halt() {
    if (this.plays === null) return;
    this.plays = null;
    this.tell({ type: "steer", do: "stop" });
    this.show();
  }

  /** @param {StageMessage} message */
  hear(message) {
    super.hear(message);
    if (message.type === "moved" && message.over && this.plays !== null) this.watched(this.plays);
    else if (message.type === "connection-lost" || message.type === "webgl-lost") this.halt();
    else if (message.type === "key") this.press(message.key ?? "");
  }

  /** @param {import("../contract.js").Interrupted["reason"]} _reason */
  async interrupted(_reason) {
    this.halt?.();
  }

  /** @param {number} number */
  watched(number) {
    this.plays = null;
    if (number === this.seen + 1) {
      this.seen = number;
      this.note();
      if (this.seen < this.drives.length) {
        setTimeout(() => !this.over && (this.hidden ? this.show() : this.goThrough()), BETWEEN_MS);
        return;
      }
    }
    this.show();
  }

  note() {
    this.keep({ seen: this.seen, ranking: this.ranking, inPile: this.inPile });
  }

  // ---- answering ---------------------------------------------------------------------------------------------------

  /** @param {number} number */
  pick(number) {
    if (!this.choosing || this.busy || this.fixed) return;
    if (this.ask === "groups") this.held = number;
    else if (this.ask === "best") this.ranking = [number];
    else if (!this.ranking.includes(number)) this.ranking.push(number);
    this.changed(number);
  }

  /** @param {number} pile */
  put(pile) {
    if (!this.choosing || this.busy || this.fixed) return;
    const number = this.held;
    this.inPile[number] = pile;
    const open = this.drives.map((_, k) => k + 1).find((k) => !(k in this.inPile));
    this.held = open ?? this.held;
    this.changed(number);
  }

  undo() {
    if (!this.choosing || !this.ranking.length || this.busy || this.fixed) return;
    this.changed(/** @type {number} */ (this.ranking.pop()));
  }

  /** @param {number} number */
  changed(number) {
    this.note();
    this.draw();
    this.needs.announce(this.name(number) + (this.left ? "" : ` ${this.own("complete")}`));
  }

  /** How many are still to be said. */
  get left() {
    if (this.ask === "best") return 1 - this.ranking.length;
    return this.drives.length - (this.ask === "groups" ? Object.keys(this.inPile).length : this.ranking.length);
  }

  /** @param {number} number */
  name(number) {
    if (this.ask === "groups") {
      const pile = this.piles[this.inPile[number]]?.dataset.name;
      return pile ? this.own("in_pile", { number, pile }) : this.own("open", { number });
    }
    const place = this.ranking.indexOf(number) + 1;
    return place ? this.own(this.ask === "best" ? "best" : "placed", { number, place }) : this.own("open", { number });
  }

  /** @param {number} i from 0 */
  colour(i) {
    return `rgb(${this.drives[i]?.querySelector("[data-colour]")?.getAttribute("data-colour")})`;
  }

  draw() {
    for (const button of this.drives) {
      const number = Number(button.dataset.drive);
      const place = this.ranking.indexOf(number) + 1;
      const pile = this.inPile[number];
      const badge = /** @type {HTMLElement} */ (button.querySelector("b"));
      badge.textContent = this.ask === "groups" ? (pile === undefined ? "" : "●".repeat(pile + 1)) : !place ? "" : this.ask === "best" ? "✓" : `${place}.`;
      button.setAttribute("aria-pressed", String(this.ask === "groups" ? this.held === number && !this.fixed : place > 0));
      button.setAttribute("aria-label", this.name(number));
    }
    this.undoButton?.setAttribute("aria-disabled", String(this.fixed || !this.ranking.length));
    this.goOn.setAttribute("aria-disabled", String(this.left > 0));
  }

  show() {
    const phase = this.plays !== null ? "playing" : this.choosing ? "choosing" : "ready";
    const changed = this.root.dataset.shown !== phase;
    this.part(phase);
    this.start.setAttribute("aria-disabled", String(!this.stageReady || this.needs.headset.missing !== null));
    if (phase === "playing") {
      const number = /** @type {HTMLElement} */ (this.root.querySelector("#playing-number"));
      number.textContent = String(this.plays);
      number.style.setProperty("--drive", this.colour((this.plays ?? 1) - 1));
      this.text("#playing-text", this.own("playing", { number: this.plays ?? 0 }));
    } else if (changed) {
      if (phase === "choosing") window.focus(); // takes the keyboard back from the stage
      const first = phase === "choosing" ? "#question" : "#start";
      /** @type {HTMLElement | null} */ (this.root.querySelector(first))?.focus({ preventScroll: true });
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || document.querySelector("dialog[open]")) return;
    if (this.press(event.key)) event.preventDefault();
  }

  /** A drive's number, pressed here or while the stage had the focus. @param {string} key @returns {boolean} */
  press(key) {
    const found = this.drives.some((button) => button.dataset.drive === key);
    if (found) this.pick(Number(key));
    else if (key === "Backspace") this.undo();
    return found || key === "Backspace";
  }

  async next() {
    if (this.busy || !this.choosing) return;
    if (this.left > 0) {
      this.needs.announce(this.own("left", { count: this.left }));
      return;
    }
    /** @type {number[][]} */
    const groups = this.piles.map((_, k) => this.drives.map((_, n) => n + 1).filter((n) => this.inPile[n] === k));
    /** @type {import("../types.js").AnswerTo<"order">} */
    const value = { ...(this.ask === "groups" ? { groups } : { order: this.ranking }), headset: this.needs.headset.used };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"order">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new Order(bar, page) };
}
