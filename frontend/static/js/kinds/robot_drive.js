// @ts-check
/** A real robot drives: it is waited for, mirrored, its weights are moved by hand or in words, and it is asked how it was. */

import { stageNeeds } from "../kind.js";
import { RobotPanel } from "../robot.js";

/** Somebody who waited longer for it takes no note of the moment. */
const MOMENT_S = 120;

class Drive extends RobotPanel {
  /**
   * @param {HTMLElement} root
   * @param {ConstructorParameters<typeof RobotPanel>[1] & {stream: string, words: (body: object) => Promise<any>}} needs
   * @param {any} run
   */
  constructor(root, needs, run) {
    super(root, needs);
    this.stream = needs.stream;
    this.words = needs.words;
    this.run = run;
    /** @type {string | null} */
    this.watched = null;
    /** @type {number | null} */
    this.liked = null;
    root.querySelectorAll("[data-liked]").forEach((point) => {
      point.addEventListener("change", () => {
        this.liked = Number(/** @type {HTMLInputElement} */ (point).value);
        this.show();
      });
    });
    this.follow();
  }

  /** @param {any} state how far the drive is */
  update(state) {
    this.run = state;
    super.update({ ...this.state });
    this.follow();
  }

  /** Watches the robot of the drive, as long as there is one. */
  follow() {
    const watched = this.run?.phase === "over" ? null : (this.run?.robot ?? null);
    if (watched !== this.watched) {
      this.watched = watched;
      if (watched) this.mirrorFrom(this.stream);
      else this.unwatch();
    }
    this.show();
    this.said();
  }

  said() {
    if (!this.run) return;
    const { phase, robot, drove, wheels_after_s: seconds, answers } = this.run;
    const words = [];
    if (phase === "over") words.push(this.own(drove ? "over" : "no_drive"));
    else if (phase === "driving") words.push(this.own("driving", { robot: robot ?? "" }));
    else words.push(robot ? this.own("waiting_for", { robot }) : this.own("waiting"));
    if (seconds && seconds < MOMENT_S && answers) words.push(this.own("wheels", { seconds: Math.round(seconds * 10) / 10, answers }));
    this.text("#live-way", words.join(" "));
  }

  get mayDecide() {
    return this.run?.phase === "over" && (!this.run.drove || this.liked !== null);
  }

  show() {
    if (!this.run) return; // still being made
    this.part("live");
    this.root.querySelector("[data-done]")?.setAttribute("aria-disabled", String(!this.mayDecide || this.needs.headset.missing !== null));
    /** @type {HTMLElement} */ (this.root.querySelector("[data-stop]")).hidden = this.run.phase !== "driving";
    /** @type {HTMLElement} */ (this.root.querySelector("#robot-liked")).hidden = !(this.run.phase === "over" && this.run.drove);
  }

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && "stop" in button.dataset) void this.quietly("stop", {});
    else super.clicked(event);
  }

  /** @param {object} body */
  read(body) {
    return this.words(body);
  }

  async done() {
    await this.decide({ ...this.controls.answer(), liked: this.run.drove ? this.liked : null });
  }
}

/** @param {import("../kind.js").KindPage<"robot_drive">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept, key } = page;
  const words = page.poster("live");
  const token = location.pathname.split("/")[2];
  const stream = `/api/session/${token}/robot/${encodeURIComponent(key)}/stream`;
  const needs = { ...stageNeeds(page, "robot"), tell, language, keep, kept, stream, words: (/** @type {object} */ body) => words("words", body) };
  return { bar: new Drive(panel, needs, page.state) };
}
