// @ts-check
/**
 * The panel beside a stage on which the robot's way is redrawn while weights are changed: two requests under way at
 * most, always for the newest weights, an older answer never over a newer one; a robot that drives goes on along its new way. The sliders are controls.js's.
 */

import { Controls } from "./controls.js";
import { speaker } from "./say.js";
import { Refused } from "./send.js";
import { StageBar } from "./stage-bar.js";

/** @typedef {import("./types.js").LiveState} LiveState */
/** @typedef {import("./controls.js").Weights} Weights */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */
/** @typedef {import("./contract.js").LivePaths} LivePaths */

/**
 * @typedef {object} LiveNeeds what a panel gets from the page beside what every bar gets
 * @property {(order: object) => void} tell the stage
 * @property {string} language
 * @property {(values: Record<string, unknown>) => void} keep
 * @property {Record<string, unknown> | null} kept
 */

/** The ways' colours on the stage: of the robot alone, of two robots as their tops are. */
const ALONE = [[47, 106, 61]];
const BOTH = [[52, 110, 180], [196, 110, 30]];

/** Requests under way: a hand that is dragged waits half as long as with one, and a server is not flooded. */
const AT_ONCE = 2;

/** @extends {StageBar<LiveState>} */
export class LivePanel extends StageBar {
  /**
   * @param {HTMLElement} root the panel
   * @param {import("./stage-bar.js").StageNeeds & LiveNeeds} needs
   */
  constructor(root, needs) {
    super(root, { phase: "live", playback_id: null }, needs);
    const { tell, language, keep, kept } = needs;
    this.tell = tell;
    this.keep = keep;
    this.language = language;
    this.own = speaker(JSON.parse(document.getElementById("live-words")?.textContent ?? "{}"), language);
    this.place = Number(kept?.place ?? 0);
    this.places = Number(root.dataset.scenes ?? 1);
    /** Which place the stage shows, as far as it was told. */
    this.stagePlace = 0;
    /** The ways that are drawn. @type {(LivePaths["paths"][number] & {colour: number[], hollow: boolean})[] | null} */
    this.paths = null;
    /** Where the robots are, while they are under way, and for how long they have been. @type {number[][] | null} */
    this.poses = null;
    /** @type {number[] | null} */
    this.clocks = null;
    /** For how long they had been when the ways that are drawn begin. @type {number[] | null} */
    this.since = null;
    this.driving = false;
    this.wanted = false;
    this.underWay = 0;
    /** How many ways were asked for, and which of them was drawn last. */
    this.requests = 0;
    this.newest = 0;
    this.orders = 0;
    this.controls = new Controls(root, JSON.parse(root.dataset.start ?? "{}"), {
      place: () => this.place,
      moved: (objective) => this.moved(objective),
      settled: () => this.note(),
    });
    this.controls.restore(kept);
    root.addEventListener("click", (event) => this.clicked(event));
    root.addEventListener("focusin", (event) => this.explain(event.target));
    root.addEventListener("pointerover", (event) => this.explain(event.target));
    this.begin();
  }

  /** Nothing of the sliders' places is lost with the page. */
  note() {
    this.keep({ weights: this.controls.weights, history: this.controls.history, place: this.place });
  }

  leave() {
    this.tell({ type: "steer", do: "stop" });
    super.leave();
  }

  /** The weights that are asked for; null: as the step begins. @returns {Weights | null} */
  get asked() {
    return this.controls.weights;
  }

  /** @param {string} _objective was changed */
  moved(_objective) {
    this.want();
  }

  // ---- the way -----------------------------------------------------------------------------------------------------

  /** The newest way is wanted. */
  want() {
    this.wanted = true;
    if (this.underWay < AT_ONCE) void this.askOn();
  }

  async askOn() {
    this.underWay += 1;
    try {
      while (this.wanted && !this.over) {
        this.wanted = false;
        await this.askOnce();
      }
    } finally {
      this.underWay -= 1;
    }
  }

  async askOnce() {
    const { place, driving } = this;
    const poses = driving ? this.poses : null;
    const since = poses && this.clocks;
    const request = (this.requests += 1);
    /** @type {import("./contract.js").LiveAsked} */
    const body = { weights: this.asked, place, poses, since };
    try {
      /** @type {LivePaths} */
      const reply = await this.needs.post("paths", body);
      if (this.over || place !== this.place || driving !== this.driving || request < this.newest) return;
      this.newest = request;
      this.draw(reply, Boolean(poses), since);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      if (!poses) await this.needs.refresh(); // a robot that has just arrived cannot go on: its old way stays
    }
  }

  /** @param {LivePaths} reply @param {boolean} onward from where the robots are @param {number[] | null} since */
  draw(reply, onward, since) {
    const colours = reply.paths.length > 1 ? BOTH : ALONE;
    const paths = reply.paths.map((path, i) => ({ ...path, colour: colours[i], hollow: i > 0 }));
    this.paths = paths;
    this.since = since;
    this.orders += 1;
    /** @type {import("./contract.js").PathsMessage} */
    const order = { do: "paths", id: String(this.orders), onward, since, paths, legend: this.legend(colours) };
    this.tell({ type: "steer", ...order });
    this.tellWay();
    this.tellLooks();
    if (!this.busy) this.show();
  }

  /** What each robot looks at on its way, where the protocol wants that said; while they drive what was said stays. */
  tellLooks() {
    const line = /** @type {HTMLElement | null} */ (this.root.querySelector("#live-looks"));
    const names = this.legend([[], []]).map((entry) => entry.name);
    const list = new Intl.ListFormat(this.language);
    const said = (this.paths ?? []).map(({ looks_at }, i) => {
      const things = list.format((looks_at ?? []).map((/** @type {string} */ thing) => this.own(`things.${thing}`)));
      return things && names[i] ? this.own("looks_at", { robot: names[i], things }) : "";
    }).filter(Boolean);
    if (line && said.length) line.textContent = said.join(" ");
  }

  /** @param {number[][]} _colours @returns {import("./contract.js").LegendEntry[]} */
  legend(_colours) {
    return [];
  }

  /** How the way is, in words. */
  tellWay() {
    const path = this.paths?.[0];
    if (!path) return;
    const seconds = path.track[path.track.length - 1][0];
    this.text("#live-way", path.arrives ? this.own("arrives", { seconds: Math.round(seconds) }) : this.own("does_not_arrive"));
    const way = /** @type {HTMLElement} */ (this.root.querySelector("#live-way"));
    way.toggleAttribute("data-attention", !path.arrives);
    way.dataset.seconds = String(seconds);
  }

  // ---- the stage ---------------------------------------------------------------------------------------------------

  /** @param {StageMessage & Record<string, any>} message */
  hear(message) {
    if (message.type === "connected") this.stagePlace = 0;
    super.hear(message);
    if (message.type === "moved") {
      this.poses = message.poses;
      this.clocks = message.clocks;
      if (message.over) this.stood();
    }
  }

  setReady() {
    super.setReady();
    this.driving = false;
    this.poses = null;
    if (this.place === this.stagePlace) this.want();
    else void this.goTo(this.place);
  }

  show() {
    this.part("live");
    const worn = this.needs.headset.missing === null;
    const may = { "[data-place]": this.stageReady, "[data-drive]": worn && this.stageReady && Boolean(this.paths) };
    for (const [button, now] of Object.entries(may)) this.root.querySelector(button)?.setAttribute("aria-disabled", String(!now));
    this.root.querySelector("[data-drive]")?.toggleAttribute("data-driving", this.driving);
    this.text("[data-drive]", this.own(this.driving ? "stop" : "drive"));
    this.root.querySelector("[data-done]")?.setAttribute("aria-disabled", String(!this.mayDecide || !worn));
  }

  /** Whether the step may be ended now: no robot is wanted of which no way was seen. @returns {boolean} */
  get mayDecide() {
    return Boolean(this.paths);
  }

  /** All robots have arrived, or can go no further. */
  stood() {
    this.driving = false;
    this.show();
  }

  /** How the robots drive. @returns {object} */
  get driveOrder() {
    return { do: "drive" };
  }

  drive() {
    if (!this.stageReady || !this.paths) return;
    this.driving = !this.driving;
    if (this.driving) {
      this.poses = this.paths.map((path) => path.track[0].slice(1));
      this.clocks = this.since;
      this.tell({ type: "steer", ...this.driveOrder });
    } else this.want(); // back to the start
    this.show();
  }

  /** @param {number} place from 0 */
  async goTo(place) {
    this.place = place;
    this.driving = false;
    this.paths = null; // nothing to drive along until its way is there
    this.text("#live-place", this.own("place", { number: place + 1, of: this.places }));
    this.note();
    this.stageReady = false;
    this.show();
    await this.needs.post("place", { place });
    this.stagePlace = place;
  }

  // ---- the panel ---------------------------------------------------------------------------------------------------

  /** What a weight does, said where the hand or the keyboard is. @param {EventTarget | null} target */
  explain(target) {
    const row = target instanceof Element ? target.closest("[data-control]") : null;
    if (row) this.text("#live-does", row.getAttribute("data-does") ?? "");
  }

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (!button || this.busy || button.getAttribute("aria-disabled") === "true") return;
    if ("drive" in button.dataset) this.drive();
    else if ("place" in button.dataset) void this.goTo((this.place + 1) % this.places);
    else if ("reset" in button.dataset) {
      this.controls.put(this.controls.start, "button");
      this.note();
    } else if ("done" in button.dataset) void this.done();
  }

  async done() {
    await this.decide(this.controls.answer());
  }

  /** @param {object} value */
  async decide(value) {
    await super.decide({ ...value, headset: this.needs.headset.used });
  }
}
