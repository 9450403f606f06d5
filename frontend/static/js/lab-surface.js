// @ts-check
/** A participants' panel on a page of the lab, over a stage of its own: nothing is answered, kept or covered here. */

import { NO_HEADSET } from "./stage-bar.js";
import { StageFrame } from "./stage-frame.js";

/**
 * @template {{ hear(message: any): void }} Bar
 * @param {new (root: HTMLElement, surface: any) => Bar} Panel
 * @param {HTMLElement} panel
 * @param {(path: string, body: any) => Promise<any>} post
 * @returns {Bar}
 */
export function onOwnStage(Panel, panel, post) {
  const holder = /** @type {HTMLElement} */ (document.getElementById("stage-frame"));
  const live = /** @type {HTMLElement} */ (document.getElementById("live"));
  const { src = "", origin = "", title = "" } = holder.dataset;
  const nothing = async () => {};
  const stage = new StageFrame(holder, origin, (message) => bar.hear(message));
  const bar = new Panel(panel, {
    key: "lab",
    post,
    answer: nothing,
    refresh: nothing,
    say: (/** @type {string} */ key) => key,
    announce: (/** @type {string} */ text) => (live.textContent = text),
    cover: () => {},
    headset: NO_HEADSET,
    reloadStage: () => stage.reload(),
    greetStage: () => stage.greet(),
    notice: () => {},
    moveOut: () => {},
    tell: (/** @type {any} */ order) => stage.draw(order),
    language: document.documentElement.lang,
    keep: () => {},
    kept: null,
  });
  stage.open(src, title);
  return bar;
}
