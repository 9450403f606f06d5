// @ts-check
/**
 * The page's part of a headset: what its bar says and which buttons it has stands as a panel in the room, where the page
 * cannot be seen, and a button that is pressed there is pressed here. So the rules are the same. Where a headset is asked
 * for and not worn, a sentence says why.
 */

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */
/** @typedef {{id: string, text: string, letter?: boolean, main?: boolean, resting?: boolean, tool?: boolean}} RoomButton */

/**
 * @typedef {object} HeadsetNeeds
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(order: object) => void} tell the stage
 * @property {(text: string | null, forMs?: number) => void} banner
 * @property {(data: object) => void} notice to the server's log
 * @property {() => void} changed it was put on or taken off, or is needed
 * @property {boolean} headPose whether it is stored how the head moves
 */

const LOOK_MS = 120; // between changes of the page and the panel
const STAYS_MS = 8000;

/** @param {Element | null | undefined} element @returns {string} its words, "" where it is not to be seen */
const words = (element) => (!element || element.closest("[hidden], .unseen") ? "" : (element.textContent ?? "").replace(/\s+/g, " ").trim());

export class Headset {
  /** @param {"offered" | "required" | null} asked by the study @param {HeadsetNeeds} needs */
  constructor(asked, needs) {
    this.asked = asked;
    this.needs = needs;
    /** Whether the step is seen with one, or in the window; null: as the study says. @type {boolean | null} */
    this.wanted = null;
    this.on = false;
    /** Whether what is shown can be seen with one. */
    this.here = false;
    /** @type {string | null} */
    this.why = null;
    this.helping = false;
    /** What presses of the room's buttons do. @type {Map<string, () => void>} */
    this.presses = new Map();
    this.sent = "";
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.clock = undefined;
  }

  get worn() {
    return this.on;
  }

  /** Why nothing can begin: what is shown is to be seen with a headset, or without. null: it can. */
  get missing() {
    const needed = this.wanted ?? (this.asked === "required" || null);
    if (needed === null || !this.here || this.on === needed) return null;
    if (!needed) return this.needs.say("headset.window");
    return this.needs.say(this.why ? `headset.refused.${this.why}` : "headset.needed");
  }

  /** @param {StageMessage} message */
  hear(message) {
    if (!this.asked) return;
    if (message.type === "state" || message.type === "connected") {
      this.offer();
    } else if (message.type === "headset") this.changed(message);
    else if (message.type === "headset-press") this.presses.get(message.id ?? "")?.();
  }

  /** Another step is shown. @param {boolean | null} wanted with a headset, in the window, or as the study says */
  use(wanted) {
    if (wanted === this.wanted) return;
    this.wanted = wanted;
    if (this.asked) this.offer();
  }

  offer() {
    const words = this.wanted === false ? null : { enter: this.needs.say("headset.enter") };
    this.needs.tell({ do: "offer", words, head_pose: this.needs.headPose });
  }

  /** @param {StageMessage} message */
  changed({ on = false, here = false, why = null, controllers, refresh_rate }) {
    const was = { on: this.on, why: this.why };
    [this.on, this.here, this.why] = [on, here, why];
    clearInterval(this.clock);
    if (on) this.clock = setInterval(() => this.show(), LOOK_MS);
    if (was.on !== on || was.why !== why) this.needs.notice({ on, why, controllers, refresh_rate });
    if (was.on === on && was.why === why && !this.missing) return;
    this.helping = false;
    this.sent = "";
    if (on) this.needs.banner(null);
    else if (this.missing) this.needs.banner(this.missing);
    else if (was.on) this.needs.banner(this.needs.say("headset.left"), STAYS_MS);
    else if (why === "denied" || why === "failed") this.needs.banner(this.needs.say(`headset.refused.${why}`), STAYS_MS);
    this.needs.changed();
    if (on) this.show();
  }

  /** The panel as the page is now; told where it changed. */
  show() {
    const panel = this.panel();
    const now = JSON.stringify(panel);
    if (now === this.sent) return;
    this.sent = now;
    this.needs.tell({ do: "panel", panel });
  }

  panel() {
    const { say } = this.needs;
    this.presses.clear();
    /** @type {RoomButton[]} */
    const buttons = [];
    const add = (/** @type {RoomButton} */ button, /** @type {() => void} */ press) => {
      buttons.push(button);
      this.presses.set(button.id, press);
    };
    const panel = { count: words(document.querySelector("#progress-text")), text: "", hint: "", buttons, quiet: false, progress: /** @type {number | null} */ (null) };
    const bar = document.querySelector("#step .trialbar");
    const cover = words(document.querySelector("#stage-cover-text"));
    const inWindow = this.wanted === false;
    if (!bar || document.body.dataset.layout !== "stage" || inWindow) {
      panel.text = say(inWindow ? "headset.window" : "headset.off");
      add({ id: "leave", text: say("headset.leave"), main: true }, () => {});
      return panel;
    }
    if (cover) return { ...panel, text: cover };
    if (this.helping) {
      panel.text = [...document.querySelectorAll("#help-dialog [data-help]:not([hidden]) p")].map((one) => one.textContent?.trim()).join("\n");
      add({ id: "back", text: say("headset.back"), main: true }, () => (this.helping = false));
      return panel;
    }
    const shown = [...bar.querySelectorAll("p, legend")].map(words).filter(Boolean);
    [panel.text, panel.hint] = [shown[0] ?? "", [...new Set(shown.slice(1)), words(document.querySelector("#banner"))].join("\n").trim()];
    panel.quiet = /** @type {HTMLElement} */ (bar).dataset.shown === "playing";
    const progress = /** @type {HTMLProgressElement | undefined} */ ([...bar.querySelectorAll("progress")].find((one) => !one.closest("[hidden]")));
    panel.progress = progress ? Math.round(progress.value * 50) / 50 : null;
    [...bar.querySelectorAll("button")].forEach((button, i) => {
      if (button.closest("[hidden]")) return;
      const letter = button.dataset.choice?.toUpperCase();
      const text = letter ?? button.textContent?.trim() ?? "";
      const resting = button.disabled || button.getAttribute("aria-disabled") === "true";
      add({ id: button.dataset.choice || button.id || `button-${i}`, text, letter: Boolean(letter), main: button.classList.contains("main"), resting }, () => button.click());
    });
    add({ id: "pause", text: say("headset.pause"), tool: true }, () => /** @type {HTMLElement | null} */ (document.querySelector("#tools [data-pause]"))?.click());
    add({ id: "help", text: say("headset.help"), tool: true }, () => (this.helping = true));
    add({ id: "leave", text: say("headset.leave"), tool: true }, () => {});
    return panel;
  }
}
