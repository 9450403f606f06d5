// @ts-check
/** Own and usual robot in the same scenes, whether that is them, and the sliders to correct it. */

import { stageNeeds } from "../kind.js";
import { LivePanel } from "../live.js";

/** @typedef {import("../contract.js").LivePaths} LivePaths */
/** @typedef {import("../contract.js").LiveReason} LiveReason */

/** As it is said: one digit. @param {number | null | undefined} amount */
const rounded = (amount) => Math.round(10 * (amount ?? 0)) / 10;

class Meeting extends LivePanel {
  /** @param {HTMLElement} root @param {ConstructorParameters<typeof LivePanel>[1]} needs */
  constructor(root, needs) {
    super(root, needs);
    this.correcting = Boolean(needs.kept?.correcting);
    this.watched = Boolean(needs.kept?.watched);
    /** @type {number | null} */
    this.agreement = typeof needs.kept?.agreement === "number" ? needs.kept.agreement : null;
    /** What was said of the own robot's choice, by place. @type {Map<number, LiveReason["did"][]>} */
    this.told = new Map(Array.isArray(needs.kept?.told) ? needs.kept.told : []);
    /** Why it drives as it does there, which is said once it has driven. @type {LiveReason[]} */
    this.why = [];
    this.inTurn = root.dataset.view !== "top_down"; // side by side is seen from above alone
    root.querySelectorAll("[data-agreement]").forEach((given) => {
      const point = /** @type {HTMLInputElement} */ (given);
      point.checked = Number(point.value) === this.agreement;
      point.addEventListener("change", () => {
        this.agreement = Number(point.value);
        this.note();
        this.show();
      });
    });
    this.show();
  }

  note() {
    const { weights, history } = this.controls;
    this.keep({ weights, history, place: this.place, agreement: this.agreement, watched: this.watched, correcting: this.correcting, told: [...this.told] });
  }

  get asked() {
    return this.correcting ? this.controls.weights : null;
  }

  get driveOrder() {
    return { do: "drive", in_turn: this.inTurn };
  }

  /** @param {number[][]} colours */
  legend(colours) {
    const own = this.correcting ? "settings" : "own";
    return [own, "usual"].map((name, i) => ({ name: this.own(name), colour: colours[i], hollow: i > 0 }));
  }

  tellWay() {
    const [own, usual] = (this.paths ?? []).map((path) => Math.round(path.track[path.track.length - 1][0]));
    const arrives = this.paths?.every((path) => path.arrives);
    this.text("#live-way", arrives ? this.own("both_arrive", { own, usual }) : this.own("does_not_arrive"));
    /** @type {HTMLElement} */ (this.root.querySelector("#live-way")).dataset.seconds = String(own);
  }

  /** @param {LivePaths} reply @param {boolean} onward @param {number[] | null} since */
  draw(reply, onward, since) {
    if (!onward) {
      this.why = reply.why ?? [];
      this.text("#meet-why", "");
    }
    super.draw(reply, onward, since);
  }

  stood() {
    this.watched = true;
    if (this.why.length && !this.correcting) {
      this.told.set(this.place, this.why.map(({ did }) => did));
      this.text("#meet-why", this.sayWhy());
    }
    this.note();
    super.stood();
  }

  sayWhy() {
    const said = this.why.map(({ did, own, usual }) => this.own(`why.${did}`, { own: rounded(own), usual: rounded(usual) }));
    return this.why[0].did === "as_usual" ? said[0] : this.own("why.here", { did: new Intl.ListFormat(this.language).format(said) });
  }

  show() {
    super.show();
    if (!this.paths) this.text("#meet-why", "");
    this.text("[data-drive]", this.own(this.driving ? "stop" : "drive_both"));
    const sliders = /** @type {HTMLElement} */ (this.root.querySelector("#meet-sliders"));
    sliders.hidden = !this.correcting;
    const opens = /** @type {HTMLElement} */ (this.root.querySelector("[data-correct]"));
    opens.hidden = Boolean(this.correcting);
    opens.setAttribute("aria-expanded", String(Boolean(this.correcting)));
  }

  get mayDecide() {
    return Boolean(this.watched && this.agreement);
  }

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && "correct" in button.dataset) {
      this.correcting = true;
      this.note();
      this.show();
      this.want();
      /** @type {HTMLElement | null} */ (this.root.querySelector("[data-ends]"))?.focus();
    } else if (button && "done" in button.dataset && button.getAttribute("aria-disabled") === "true") {
      this.needs.announce(this.own(this.watched ? "say_first" : "watch_first"));
      this.text("#live-way", this.own(this.watched ? "say_first" : "watch_first"));
    } else super.clicked(event);
  }

  async done() {
    if (this.agreement === null) return;
    /** @type {import("../types.js").AnswerTo<"meet_your_robot">} */
    const value = { ...this.controls.answer(), agreement: this.agreement, why: [...this.told].map(([place, did]) => ({ place, did })) };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"meet_your_robot">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept } = page;
  return { bar: new Meeting(panel, { ...stageNeeds(page, "live"), tell, language, keep, kept }) };
}
