// @ts-check
/**
 * The panel beside a stage that mirrors a real robot: the sliders are live.js's, what they stand at goes to the robot.
 * Two requests under way at most, always with the newest weights.
 */

import { LivePanel } from "./live.js";
import { Refused } from "./send.js";

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

export class RobotPanel extends LivePanel {
  /** Where robots are told of. @type {EventSource | null} */
  #stream = null;
  /** @type {any} what it said last */
  robot = null;

  /** @param {string} url of the robot's stream */
  mirrorFrom(url) {
    this.#stream?.close();
    this.#stream = new EventSource(url);
    this.#stream.addEventListener("robot", (event) => {
      this.robot = JSON.parse(/** @type {MessageEvent} */ (event).data);
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
      const { pose, scan, plan, people } = this.robot;
      this.tell({ type: "mirror", pose, scan, plan, people });
    }
    this.said();
  }

  /** The robot said something, or nothing for long. */
  said() {}

  setReady() {
    super.setReady();
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
