// @ts-check
/**
 * A rollout that halts, then its objects from the most important to the least: picked in the room or in the list, which
 * are one control. The ranking is kept here; the room shows it.
 */

import { stageNeeds } from "../kind.js";
import { speaker } from "../say.js";
import { SingleTrajectory } from "../single.js";

/** @typedef {import("../stage-frame.js").StageMessage & {thing?: string | null}} StageMessage */

class ImportanceRanking extends SingleTrajectory {
  /**
   * @param {HTMLElement} root the bar
   * @param {import("../types.js").ProgressOf<"importance_ranking">} state
   * @param {import("../stage-bar.js").StageNeeds} needs
   * @param {(order: any) => void} tell the stage
   * @param {string} language
   */
  constructor(root, state, needs, tell, language) {
    super(root, state, needs);
    this.tell = tell;
    this.words = JSON.parse(document.getElementById("ranking-words")?.textContent ?? "{}");
    this.own = speaker(this.words.script, language);
    /** @type {HTMLButtonElement[]} */
    this.things = [...root.querySelectorAll(/** @type {"button"} */ ("[data-thing]"))];
    this.undoButton = /** @type {HTMLButtonElement} */ (root.querySelector("[data-undo]"));
    /** What stands already, the most important first; a replay's is whole and stays. @type {string[]} */
    this.ranking = JSON.parse(root.dataset.ranked ?? "[]");
    this.fixed = this.ranking.length > 0;
    /** @type {number[]} */
    this.placed = [];
    this.undone = 0;
    /** @type {string | null} */
    this.pointed = null;
    this.since = 0;
    for (const button of this.things) {
      const thing = button.dataset.thing ?? "";
      button.addEventListener("click", () => this.pick(thing));
      for (const [event, over] of /** @type {const} */ ([["focus", true], ["pointerenter", true], ["blur", false], ["pointerleave", false]])) {
        button.addEventListener(event, () => this.point(over ? thing : null));
      }
    }
    this.undoButton.addEventListener("click", () => this.undo());
    this.draw();
    if (this.choosing) this.beginRanking(); // after a reload
  }

  get choosing() {
    return this.state.phase === "choosing";
  }

  /** @param {StageMessage} message */
  hear(message) {
    super.hear(message);
    if (message.type === "picked" && message.thing) this.pick(message.thing);
    else if (message.type === "pointed" && this.choosing) {
      for (const button of this.things) button.toggleAttribute("data-pointed", button.dataset.thing === message.thing);
    }
  }

  setReady() {
    this.tell({ type: "explain", do: "words", words: { reasons: this.words.reasons } });
    super.setReady();
    this.tellRoom();
  }

  show() {
    const before = this.shown;
    super.show();
    if (this.choosing && before !== "choosing" && this.things) this.beginRanking();
  }

  beginRanking() {
    this.since = performance.now();
    this.things[0]?.focus({ preventScroll: true });
    this.needs.announce(this.own("halted"));
    this.tellRoom();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.choosing || this.busy || document.querySelector("dialog[open]")) return;
    if (event.key === "Backspace" || ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z")) {
      event.preventDefault();
      this.undo();
    }
    const step = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }[event.key];
    const at = this.things.findIndex((button) => button === document.activeElement);
    if (step === undefined || at < 0) return;
    event.preventDefault();
    this.things[(at + step + this.things.length) % this.things.length].focus();
  }

  /** @param {string} thing gets the next place */
  pick(thing) {
    if (!this.choosing || this.busy || this.fixed || this.ranking.includes(thing)) return;
    if (!this.things.some((button) => button.dataset.thing === thing)) return;
    this.ranking.push(thing);
    this.placed.push(Math.round(performance.now() - this.since) / 1000);
    this.changed();
  }

  undo() {
    if (!this.ranking.length || this.fixed || this.busy) return;
    this.ranking.pop();
    this.placed.pop();
    this.undone += 1;
    this.changed();
  }

  changed() {
    this.draw();
    this.tellRoom();
    const last = this.ranking[this.ranking.length - 1];
    const name = this.things.find((button) => button.dataset.thing === last)?.dataset.name ?? "";
    if (this.ranking.length === this.things.length) this.needs.announce(this.own("complete"));
    else if (last) this.needs.announce(this.own("placed", { name, place: this.ranking.length }));
    else this.needs.announce(this.own("empty"));
  }

  draw() {
    const whole = this.ranking.length === this.things.length;
    for (const button of this.things) {
      const place = this.ranking.indexOf(button.dataset.thing ?? "") + 1;
      const number = button.querySelector("b");
      if (number) number.textContent = place ? String(place) : "";
      button.setAttribute("aria-pressed", String(place > 0));
      const values = { name: button.dataset.name ?? "", place, of: this.things.length };
      button.setAttribute("aria-label", this.own(place ? "named_placed" : "named", values));
    }
    this.undoButton.setAttribute("aria-disabled", String(this.fixed || !this.ranking.length));
    this.goOn.setAttribute("aria-disabled", String(!whole));
  }

  /** @param {string | null} thing that is meant in the list */
  point(thing) {
    this.pointed = thing;
    this.tellRoom();
  }

  tellRoom() {
    if (!this.choosing || !this.stageReady) return;
    const words = Object.fromEntries(this.things.map((button) => [button.dataset.thing, button.dataset.name]));
    this.tell({ type: "explain", do: "rank", words, places: this.ranking, pointed: this.pointed });
  }

  async next() {
    if (this.busy || !this.choosing) return;
    if (this.ranking.length < this.things.length) {
      this.needs.announce(this.own("open", { left: this.things.length - this.ranking.length }));
      return;
    }
    /** @type {import("../types.js").AnswerTo<"importance_ranking">} */
    const value = { ranking: this.ranking, undone: this.undone, placed_s: this.placed, headset: this.needs.headset.used };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"importance_ranking">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const bar = /** @type {HTMLElement} */ (page.step.querySelector("#trial"));
  return { bar: new ImportanceRanking(bar, page.state, stageNeeds(page, "trials"), page.tell, page.language) };
}
