// @ts-check
/**
 * The analysts' page of weights by hand: the participants' panel (live.js) over a stage of one's own. Ways are asked for
 * by address, nothing is stored, and the links beside it carry the weights on.
 */

import { LivePanel } from "./live.js";
import { onOwnStage } from "./lab-surface.js";
import { ask } from "./send.js";

class LabLive extends LivePanel {
  /** @param {string} _objective */
  moved(_objective) {
    this.carry();
    super.moved(_objective);
  }

  setReady() {
    super.setReady();
    this.carry();
  }

  get words() {
    return Object.entries(this.controls.weights).map(([name, weight]) => `${name}=${weight}`).join(",");
  }

  /** Links and the command line's name of what stands there now. */
  carry() {
    const { policy = "", reference = "" } = this.root.dataset;
    const words = this.words;
    this.text("#live-reference", words ? `${reference}@${words}` : reference);
    for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (this.root.querySelectorAll("[data-carries]"))) {
      link.href = `${link.dataset.carries}&${addressed(policy, this.controls.weights)}`;
    }
    const compare = /** @type {HTMLAnchorElement} */ (this.root.querySelector("[data-carries-to-compare]"));
    compare.href = `/lab/compare?policy_b=${policy}&weights_b=${encodeURIComponent(words)}`;
  }
}

/** @param {string} policy @param {import("./controls.js").Weights} weights */
function addressed(policy, weights) {
  return [`policy_a=${policy}`, ...Object.entries(weights).map(([name, weight]) => `a_${name}=${weight}`)].join("&");
}

const panel = /** @type {HTMLElement} */ (document.getElementById("live-panel"));

/** @param {string} path @param {any} body @returns {Promise<any>} */
async function post(path, body) {
  if (path !== "paths") return {};
  const { weights, poses } = body;
  const { policy = "", scene = "" } = panel.dataset;
  const pose = poses ? `&x=${poses[0][0]}&y=${poses[0][1]}&yaw=${poses[0][2]}` : "";
  return ask(`/lab/live/paths?scene=${scene}&${addressed(policy, weights)}${pose}`);
}

onOwnStage(LabLive, panel, post);
