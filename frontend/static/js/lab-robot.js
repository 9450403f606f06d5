// @ts-check
/** The lab's page of one robot: it is mirrored on a stage, its weights are moved, a person is put where the floor is pressed. */

import { onOwnStage } from "./lab-surface.js";
import { RobotPanel } from "./robot.js";
import { pause, Refused } from "./send.js";

/** The run's own page shows what it became. */
const RELOAD_MS = 600;

class LabRobot extends RobotPanel {
  said() {
    const state = this.robot?.state;
    this.text("#robot-state", state ? this.own(`states.${state}`) : this.own("away"));
    const away = document.getElementById("robot-away");
    if (away) away.hidden = Boolean(state);
    const speed = this.robot ? this.own("speed", { speed: Math.abs(this.robot.speed[0]).toFixed(2) }) : "";
    const after = this.followedAfter;
    const followed = this.robot && after !== null ? this.own("followed", { seconds: after.toFixed(2) }) : "";
    this.text("#live-way", [this.robot?.reason, speed, followed].filter(Boolean).join(" · "));
    const { run, runState } = this.root.dataset;
    const over = run && runState === "started" && this.robot && this.robot.run !== run;
    if (over || (!run && this.robot?.run) || this.robot?.wheels_after_s) setTimeout(() => location.reload(), RELOAD_MS);
  }

  /** @param {string} selector @param {string} text */
  text(selector, text) {
    const found = document.querySelector(selector);
    if (found && found.textContent !== text) found.textContent = text;
  }

  /** Somebody else moved them: the controls follow. @param {import("./controls.js").Weights} weights */
  driveOtherwise(weights) {
    this.controls.weights = { ...weights };
    this.controls.show();
  }

  show() {}
}

const panel = /** @type {HTMLElement} */ (document.getElementById("live-panel"));
const { api = "", csrf = "", run = "" } = panel.dataset;

/** @param {string} path @param {object} body @returns {Promise<any>} */
async function post(path, body) {
  if (!["weights", "person", "words"].includes(path) || (path === "weights" && !run)) return {};
  const headers = { "Content-Type": "application/json", "X-CSRF": csrf };
  const answered = await fetch(`${api}/${path}`, { method: "POST", headers, body: JSON.stringify(body) });
  if (answered.status === 429) await pause(500);
  else if (!answered.ok) throw new Refused(answered.status, (await answered.json().catch(() => ({}))).error ?? {});
  return answered.status === 200 ? answered.json() : {};
}

const bar = onOwnStage(LabRobot, panel, post);
bar.mirrorFrom(`${api}/stream`);
