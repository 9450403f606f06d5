// @ts-check
/**
 * Speaking aloud: the microphone is asked for only after somebody agreed, parts are sent while they speak, and whoever
 * has no microphone goes on without.
 */

import { pageData } from "../say.js";
import { pause } from "../send.js";

const TYPE = "audio/webm;codecs=opus";
const BITS_PER_SECOND = 32_000;
const PART_MS = 5_000;
/** Bytes of a part; less waits for the next one. */
const SMALLEST = 1_024;
const LONGEST_WAIT_MS = 60_000;

class Voice {
  /** @param {import("../kind.js").KindPage<"think_aloud">} page */
  constructor(page) {
    this.page = page;
    const find = (/** @type {string} */ what) => /** @type {HTMLElement} */ (page.step.querySelector(what));
    this.form = /** @type {HTMLFormElement} */ (find("#step-form"));
    this.panel = find("#voice-panel");
    this.button = /** @type {HTMLButtonElement} */ (find("#voice-button"));
    this.told = find("#voice-told");
    this.main = /** @type {HTMLButtonElement} */ (find(".bottombar .main"));
    this.seconds = 60 * Number(this.form.dataset.minutes);
    this.address = `/api/session/${pageData().token}/voice/${encodeURIComponent(page.key)}`;
    /** @type {MediaRecorder | null} */
    this.recorder = null;
    /** @type {"" | "denied" | "missing" | "lost"} */
    this.problem = "";
    this.recorded = false;
    this.part = 0;
    this.began = 0;
    this.clock = 0;
    this.busy = false;
    /** @type {Promise<void>} one part after the other */
    this.sending = Promise.resolve();
    this.form.addEventListener("change", () => this.chosen());
    this.button.addEventListener("click", () => (this.recorder ? this.stop() : this.start()));
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.goOn();
    });
    this.chosen();
    find("h1").focus({ preventScroll: true });
  }

  get agreed() {
    return /** @type {HTMLInputElement | null} */ (this.form.querySelector("input[name=agreed]:checked"))?.value ?? "";
  }

  chosen() {
    if (this.agreed === "no" && this.recorder) this.stop();
    this.panel.hidden = this.agreed !== "yes";
    const done = this.agreed === "no" || (this.agreed === "yes" && !this.recorder && (this.recorded || this.problem !== ""));
    this.main.disabled = !done;
  }

  async start() {
    this.problem = "";
    this.recorded = false;
    if (this.busy) return;
    this.busy = true;
    try {
      if (!navigator.mediaDevices?.getUserMedia || !window.MediaRecorder?.isTypeSupported(TYPE)) return this.fail("missing");
      const sound = await navigator.mediaDevices.getUserMedia({ audio: true });
      if (!this.form.isConnected) return sound.getTracks().forEach((track) => track.stop());
      await this.sending;
      this.part = 0;
      this.record(sound);
    } catch (error) {
      this.fail(error instanceof DOMException && error.name === "NotAllowedError" ? "denied" : "missing");
    } finally {
      this.busy = false;
    }
  }

  /** @param {MediaStream} sound */
  record(sound) {
    const recorder = new MediaRecorder(sound, { mimeType: TYPE, audioBitsPerSecond: BITS_PER_SECOND });
    let waiting = new Blob();
    this.recorder = recorder;
    recorder.addEventListener("dataavailable", ({ data }) => {
      waiting = new Blob([waiting, data], { type: "audio/webm" });
      if (waiting.size < SMALLEST && recorder.state !== "inactive") return; // the first part must name its sound
      if (waiting.size) this.send(waiting);
      waiting = new Blob();
    });
    recorder.addEventListener("stop", () => this.ended(sound));
    recorder.addEventListener("error", () => this.fail("lost"));
    sound.getTracks()[0].addEventListener("ended", () => this.stop());
    recorder.start(PART_MS);
    this.began = performance.now();
    this.button.textContent = this.page.say("voice.stop");
    this.clock = window.setInterval(() => this.tick(), 500);
    this.tick();
    this.chosen();
  }

  tick() {
    const passed = Math.floor((performance.now() - this.began) / 1000);
    this.told.textContent = this.page.say("voice.recording", { passed: minutes(passed), most: minutes(this.seconds) });
    if (passed >= this.seconds) this.stop();
  }

  stop() {
    if (this.recorder && this.recorder.state !== "inactive") this.recorder.stop();
  }

  /** @param {MediaStream} sound */
  async ended(sound) {
    clearInterval(this.clock);
    sound.getTracks().forEach((track) => track.stop());
    const length = minutes(Math.floor((performance.now() - this.began) / 1000));
    this.button.disabled = true;
    await this.sending;
    this.button.disabled = false;
    this.recorder = null;
    this.button.textContent = this.page.say("voice.again");
    if (this.problem === "") {
      this.recorded = true;
      this.told.textContent = this.page.say("voice.recorded", { length });
    }
    this.chosen();
  }

  /** @param {Blob} data */
  send(data) {
    const part = this.part;
    this.part += 1;
    this.sending = this.sending.then(async () => {
      if (this.problem === "" && !(await this.deliver(part, data))) this.fail("lost");
    });
  }

  /** @param {number} part @param {Blob} data @returns {Promise<boolean>} whether the server has it */
  async deliver(part, data) {
    const until = performance.now() + LONGEST_WAIT_MS;
    for (let wait = 500; ; wait = Math.min(2 * wait, 8_000)) {
      try {
        const headers = { "Content-Type": "audio/webm" };
        const answer = await fetch(`${this.address}?part=${part}`, { method: "POST", headers, body: data });
        if (answer.ok) return true;
        if (answer.status < 500 && answer.status !== 429) return false;
      } catch {
        // no connection: once more
      }
      if (performance.now() > until) return false;
      await pause(wait);
    }
  }

  /** @param {"denied" | "missing" | "lost"} why */
  fail(why) {
    this.problem = why;
    this.told.textContent = this.page.say(`voice.${why}`);
    this.stop();
    this.chosen();
  }

  async goOn() {
    if (this.busy || this.main.disabled) return;
    this.busy = true;
    this.main.setAttribute("aria-disabled", "true");
    try {
      const agreed = this.agreed === "yes";
      /** @type {import("../types.js").AnswerTo<"think_aloud">} */
      const value = { agreed, problem: agreed && !this.recorded ? this.problem : "" };
      await this.page.answer(value);
    } finally {
      this.busy = false;
      this.main.removeAttribute("aria-disabled");
    }
  }

  update() {}

  hear() {}

  leave() {
    clearInterval(this.clock);
    this.stop();
  }
}

/** @param {number} seconds */
function minutes(seconds) {
  return `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
}

/** @param {import("../kind.js").KindPage<"think_aloud">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  return { bar: new Voice(page) };
}
