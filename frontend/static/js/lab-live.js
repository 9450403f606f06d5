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
    this.rename();
    super.moved(_objective);
  }

  setReady() {
    super.setReady();
    this.carry();
  }

  get words() {
    return Object.entries(this.controls.weights).map(([name, weight]) => `${name}=${weight}`).join(",");
  }

  /** The address and the links to it, once somebody has moved something. */
  rename() {
    const { policy = "" } = this.root.dataset;
    const named = this.words ? `${policy}@${this.words}` : policy;
    history.replaceState(null, "", renamed(location.href, named));
    for (const link of /** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll("[data-tab], [data-same]"))) {
      link.href = renamed(link.href, named);
    }
  }

  /** The link to the comparison and the command line's name of what stands there now. */
  carry() {
    const { policy = "", reference = "" } = this.root.dataset;
    const words = this.words;
    this.text("#live-reference", words ? `${reference}@${words}` : reference);
    const compare = /** @type {HTMLAnchorElement} */ (this.root.querySelector("[data-carries-to-compare]"));
    compare.href = `/lab/compare?policy_b=${encodeURIComponent(policy)}&weights_b=${encodeURIComponent(words)}`;
  }
}

/** @param {string} address @param {string} named the policy with its weights */
function renamed(address, named) {
  const url = new URL(address);
  const readable = encodeURIComponent(named).replace(/%2F/g, "/").replace(/%40/g, "@").replace(/%3D/g, "=").replace(/%2C/g, ",");
  url.searchParams.delete("policy");
  const others = url.searchParams.toString();
  return `${url.pathname}?policy=${readable}${others ? `&${others}` : ""}`;
}

const panel = /** @type {HTMLElement} */ (document.getElementById("live-panel"));

/** @param {string} path @param {any} body @returns {Promise<any>} */
async function post(path, body) {
  if (path !== "paths") return {};
  const { weights, poses } = body;
  const { policy = "", scene = "" } = panel.dataset;
  const words = Object.entries(weights).map(([name, weight]) => `${name}=${weight}`).join(",");
  const pose = poses ? `&x=${poses[0][0]}&y=${poses[0][1]}&yaw=${poses[0][2]}` : "";
  return ask(`/lab/live/paths?scene=${scene}&policy=${encodeURIComponent(words ? `${policy}@${words}` : policy)}${pose}`);
}

onOwnStage(LabLive, panel, post);
