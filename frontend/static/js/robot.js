// @ts-check
/**
 * The panel beside a stage that mirrors a real robot: the sliders are live.js's, what they stand at goes to the robot,
 * as does what a sentence is read as. Two requests under way at most, always with the newest weights.
 */

import { LivePanel } from "./live.js";
import { Refused } from "./send.js";

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

/** Weights that differ by less are the same. */
const SAME = 0.0051;
/** So long after a hand's last change what the robot drives by is still to come. */
const UNDER_WAY_MS = 3000;

/** @param {import("./controls.js").Weights} one @param {import("./controls.js").Weights} other */
const same = (one, other) => Object.keys({ ...one, ...other }).every((name) => Math.abs((one[name] ?? 0) - (other[name] ?? 0)) < SAME);

/** A place of the map in the frame that is there in it. @param {number[]} frame x, y, yaw @param {number[]} place */
function into([x0, y0, yaw], [x, y]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [c * (x - x0) + s * (y - y0), c * (y - y0) - s * (x - x0)];
}

export class RobotPanel extends LivePanel {
  /** Where robots are told of. @type {EventSource | null} */
  #stream = null;
  /** @type {any} what it said last */
  robot = null;
  /** When the weights were last changed here, while the robot does not yet drive by them. @type {number | null} */
  changedAt = null;
  /** From that to its first command by them, s. @type {number | null} */
  followedAfter = null;
  /** What stands in its setup's map. @type {number[][][]} */
  walls = JSON.parse(this.root.dataset.walls ?? "[]");
  /** Where the walls were drawn. */
  wallsAt = "";

  /** @param {string} url of the robot's stream */
  mirrorFrom(url) {
    this.#stream?.close();
    this.#stream = new EventSource(url);
    this.#stream.addEventListener("robot", (event) => {
      this.robot = JSON.parse(/** @type {MessageEvent} */ (event).data);
      this.compareWeights();
      this.mirror();
    });
    this.#stream.addEventListener("away", () => {
      this.robot = null;
      this.said();
    });
  }

  unwatch() {
    this.#stream?.close();
    this.#stream = null;
  }

  leave() {
    this.unwatch();
    super.leave();
  }

  mirror() {
    if (this.robot && this.stageReady) {
      const { pose, scan, plan, people, in_map: at } = this.robot;
      const known = JSON.stringify(at ?? null);
      const walls = known === this.wallsAt ? undefined : at ? this.walls.map((wall) => wall.map((place) => into(at, place))) : [];
      this.wallsAt = known;
      this.tell({ type: "mirror", pose, scan, plan, people, walls });
    }
    this.said();
  }

  /** Whether it is driven by what the controls stand at, and how long that took. */
  compareWeights() {
    const { weights, since_s: since } = this.robot;
    if (!weights) return;
    const passed = this.changedAt === null ? null : performance.now() - this.changedAt;
    if (!same(weights, this.controls.weights)) {
      if (passed === null || passed > UNDER_WAY_MS) this.driveOtherwise(weights);
    } else if (passed !== null) {
      this.changedAt = null;
      if (1000 * since < passed) this.followedAfter = passed / 1000 - since;
    }
  }

  /** It is driven by weights that nobody set here. @param {import("./controls.js").Weights} _weights */
  driveOtherwise(_weights) {}

  /** @param {string} objective */
  moved(objective) {
    this.changedAt = performance.now();
    super.moved(objective);
  }

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && "say" in button.dataset) void this.readWish();
    else super.clicked(event);
  }

  /** What a sentence is read as. @param {object} body @returns {Promise<any>} */
  read(body) {
    return this.needs.post("words", body);
  }

  /** Sets the controls by the sentence in the field. */
  async readWish() {
    const field = /** @type {HTMLInputElement} */ (this.root.querySelector("#robot-sentence"));
    if (!field.value.trim()) return field.focus();
    try {
      const { weights } = await this.read({ sentence: field.value });
      const understood = Object.keys(weights).length > 0;
      if (understood) this.controls.put(weights, "words");
      else this.needs.announce(this.own("nothing_understood"));
      this.text("#robot-read", understood ? "" : this.own("nothing_understood"));
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
    }
  }

  /** The robot said something, or nothing for long. */
  said() {}

  setReady() {
    super.setReady();
    this.wallsAt = "";
    this.mirror();
  }

  /** @param {StageMessage & Record<string, any>} message */
  hear(message) {
    super.hear(message);
    if (message.type === "floor") void this.quietly("person", { place: message.place });
  }

  /** Nothing is asked of the server before somebody moves a control. */
  async askOnce() {
    if (this.controls.history.length) await this.quietly("weights", { weights: this.controls.weights });
  }

  /** What came too late for this drive is no trouble. @param {string} path @param {object} body */
  async quietly(path, body) {
    try {
      await this.needs.post(path, body);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
    }
  }
}
