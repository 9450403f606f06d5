// @ts-check
/**
 * The page's part of a headset: what its bar says and which buttons it has stands as a panel in the room, where the page
 * cannot be seen, and a button that is pressed there is pressed here. So the rules are the same. Where a headset is asked
 * for and not worn, a sentence says why.
 */

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */
/** @typedef {{id: string, text: string, letter?: boolean, main?: boolean, resting?: boolean, tool?: boolean, pressed?: boolean, slides?: boolean}} RoomButton */
/** @typedef {{text: string, share: number | null, buttons: RoomButton[], ends: string[] | null}} RoomRow a slider, or points of a scale */

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
const MANY = 4; // rows, beside which there is place for few words
const STEPS = 20; // of a slider by its minus and plus
/** What of a bar is no use inside: not seen, for a keyboard or for the window alone. */
const LEFT_OUT = "[hidden], .unseen, [data-window], .meet-ends, [role=slider]";
/** Phases in which a robot drives: nothing covers it. */
const QUIET = ["playing", "driving", "walking"];

/** @param {Element | null | undefined} element @returns {string} its words, "" where it is not to be seen */
const words = (element) => (!element || element.closest("[hidden], .unseen") ? "" : (element.textContent ?? "").replace(/\s+/g, " ").trim());

/** What a button says. @param {Element} button @returns {string} */
const caption = (button) => {
  /** @type {string[]} */
  const parts = [...button.childNodes].map((part) => {
    if (!(part instanceof Element)) return part.textContent ?? "";
    return part.childElementCount ? caption(part) : words(part);
  });
  return parts.join(" ").replace(/\s+/g, " ").trim();
};

/** By which hand a control is changed next, for controls.js. @param {Element} control */
const tellHand = (control) => control.dispatchEvent(new Event("byheadset", { bubbles: true }));

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
    this.comfort = { snap: true, narrow: true };
    /** What presses of the room's buttons do. @type {Map<string, (message: StageMessage) => void>} */
    this.presses = new Map();
    this.sent = "";
    /** With what a button was pressed last. @type {import("./contract.js").HeadsetUsed | null} */
    this.pressedWith = null;
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.clock = undefined;
  }

  get worn() {
    return this.on;
  }

  /** With what an answer is given now, as it is sent with it; null: in the window. @returns {import("./contract.js").HeadsetUsed | null} */
  get used() {
    if (!this.on) return null;
    const { controllers, refresh_rate, pointing } = this.pressedWith ?? {};
    return { controllers, refresh_rate, pointing };
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
    else if (message.type === "headset-press") {
      this.pressedWith = message.headset ?? this.pressedWith;
      this.presses.get(message.id ?? "")?.(message);
    }
  }

  /** Another step is shown. @param {boolean | null} wanted with a headset, in the window, or as the study says */
  use(wanted) {
    if (wanted === this.wanted) return;
    this.wanted = wanted;
    if (this.asked) this.offer();
  }

  offer() {
    const words = this.wanted === false ? null : { enter: this.needs.say("headset.enter") };
    const required = this.wanted ?? this.asked === "required";
    this.needs.tell({ do: "offer", required, words, head_pose: this.needs.headPose });
    this.needs.tell({ do: "comfort", ...this.comfort });
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

  /** Sliders and scales of the bar, each a row. @param {Element} bar @returns {RoomRow[]} */
  rows(bar) {
    /** @type {Map<string, RoomRow>} */
    const rows = new Map();
    const inputs = /** @type {NodeListOf<HTMLInputElement>} */ (bar.querySelectorAll("input[type=range], input[type=radio]"));
    inputs.forEach((input, i) => {
      if (input.closest(LEFT_OUT) || input.disabled) return;
      if (input.type === "radio") {
        const scale = input.closest("fieldset") ?? input.closest(".scale");
        const ends = [...(scale?.querySelectorAll(".scale-low, .scale-high, .meet-ends span") ?? [])].map(words);
        const row = rows.get(input.name) ?? { text: "", share: null, buttons: [], ends: ends.length === 2 ? ends : null };
        rows.set(input.name, row);
        const id = `${input.name}-${input.value}`;
        row.buttons.push({ id, text: input.value, pressed: input.checked });
        this.presses.set(id, () => {
          tellHand(input);
          input.click();
        });
        return;
      }
      const [low, high, step] = [Number(input.min), Number(input.max), Number(input.step) || 1];
      const by = Math.max(step, Math.round((high - low) / STEPS / step) * step);
      const id = input.id || `slider-${i}`;
      const name = input.getAttribute("aria-label") || words(input.closest("label")?.querySelector("span"));
      const now = input.getAttribute("aria-valuetext") ?? (input.dataset.rating === undefined ? input.value : "");
      const ends = [...(input.closest(".scale")?.querySelectorAll(".scale-low, .scale-high") ?? [])].map(words);
      const set = (/** @type {number} */ value, settled = true) => {
        tellHand(input);
        input.value = String(value);
        input.dispatchEvent(new Event("input", { bubbles: true }));
        if (settled) input.dispatchEvent(new Event("change", { bubbles: true }));
      };
      const add = (/** @type {RoomButton} */ button, /** @type {(message: StageMessage) => void} */ press) => {
        this.presses.set(button.id, press);
        return button;
      };
      rows.set(id, {
        text: ends.length === 2 ? ends.join(" – ") : [name, now].filter(Boolean).join(": "),
        share: (Number(input.value) - low) / (high - low),
        ends: null,
        buttons: [
          add({ id: `${id}-less`, text: "−" }, () => set(Math.max(low, Number(input.value) - by))),
          add({ id: `${id}-set`, text: "", slides: true }, ({ share, settled }) => {
            if (share !== undefined) set(low + Math.round((share * (high - low)) / step) * step, settled);
          }),
          add({ id: `${id}-more`, text: "+" }, () => set(Math.min(high, Number(input.value) + by))),
        ],
      });
    });
    return [...rows.values()];
  }

  /** What makes being moved by a stick bearable, which one can do without. @param {(button: RoomButton, press: () => void) => void} add */
  addComfort(add) {
    for (const [name, on, off] of /** @type {const} */ ([["snap", "turn_steps", "turn_smooth"], ["narrow", "narrow_on", "narrow_off"]])) {
      add({ id: name, text: this.needs.say(`headset.${this.comfort[name] ? on : off}`), tool: true }, () => {
        this.comfort[name] = !this.comfort[name];
        this.needs.tell({ do: "comfort", ...this.comfort });
      });
    }
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
    const panel = {
      count: words(document.querySelector("#progress-text")), text: "", hint: "", buttons, rows: /** @type {RoomRow[]} */ ([]),
      quiet: false, beside: false, progress: /** @type {number | null} */ (null),
    };
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
    panel.quiet = QUIET.includes(/** @type {HTMLElement} */ (bar).dataset.shown ?? "");
    if (!panel.quiet) panel.rows = this.rows(bar);
    const shown = [...bar.querySelectorAll(panel.rows.length > MANY ? "h1, legend, .live-way" : "h1, p, legend, li")]
      .filter((one) => !one.closest(LEFT_OUT) && !one.querySelector("button"))
      .map(words)
      .filter(Boolean);
    [panel.text, panel.hint] = [shown[0] ?? "", [...new Set(shown.slice(1)), words(document.querySelector("#banner"))].join("\n").trim()];
    panel.beside = bar.classList.contains("livepanel");
    const progress = /** @type {HTMLProgressElement | undefined} */ ([...bar.querySelectorAll("progress")].find((one) => !one.closest("[hidden]")));
    panel.progress = progress ? Math.round(progress.value * 50) / 50 : null;
    [...bar.querySelectorAll("button")].forEach((button, i) => {
      if (button.closest(LEFT_OUT)) return;
      const letter = button.dataset.choice?.toUpperCase();
      const resting = button.disabled || button.getAttribute("aria-disabled") === "true";
      const pressed = button.getAttribute("aria-pressed") === "true";
      const id = button.dataset.choice || button.dataset.thing || button.id || `button-${i}`;
      add({ id, text: letter ?? caption(button), letter: Boolean(letter), main: button.classList.contains("main"), resting, pressed }, () => {
        tellHand(button);
        button.click();
      });
    });
    if (/** @type {HTMLElement} */ (bar).dataset.person === "walks" && !panel.quiet) this.addComfort(add);
    add({ id: "pause", text: say("headset.pause"), tool: true }, () => /** @type {HTMLElement | null} */ (document.querySelector("#tools [data-pause]"))?.click());
    add({ id: "help", text: say("headset.help"), tool: true }, () => (this.helping = true));
    add({ id: "leave", text: say("headset.leave"), tool: true }, () => {});
    return panel;
  }
}
