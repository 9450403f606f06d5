// @ts-check
/**
 * The bar under a drawing: undo, speed, let it drive, keep, draw again. The pen itself is the stage's (app/client/draw.js);
 * what becomes of a stroke is the server's. Nothing that was drawn is lost: a stroke goes to the server before anything.
 */

import { Refused, newRequestId, pause } from "./send.js";
import { speaker } from "./say.js";

/** @typedef {import("./types.js").TrialState} TrialState */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

/**
 * @typedef {object} DrawingNeeds what the drawing gets from the page
 * @property {string} key of the step
 * @property {(path: string, body: object) => Promise<any>} post to `/api/session/TOKEN/drawing/KEY/PATH`
 * @property {(value: object) => Promise<void>} answer keeps the path and moves on
 * @property {() => Promise<void>} refresh asks the server where the session stands
 * @property {(order: object) => void} tell the stage's pen
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(text: string) => void} announce to screen readers
 * @property {(text: string | null) => void} cover lays a sentence over the stage, null takes it away
 * @property {() => void} reloadStage
 * @property {ReturnType<typeof import("./notice.js").noticer>} notice to the server's log
 * @property {() => void} moveOut another window has taken over
 * @property {string} language
 */

const EARLY_WAIT_MS = 400;
const EARLY_TRIES = 25;
const ANNOUNCE_EVERY_MS = 1500;
const PEN_KEYS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Enter", "Backspace", "+", "-"];
/** Why the stage stopped a drive, in the words of the server. @type {Record<string, "hidden" | "connection" | "webgl_lost">} */
const REASONS = { "tab-hidden": "hidden", "webgl-lost": "webgl_lost" };

export class Drawing {
  /**
   * @param {HTMLElement} root the bar
   * @param {TrialState} state
   * @param {DrawingNeeds} needs
   */
  constructor(root, state, needs) {
    this.root = root;
    this.needs = needs;
    this.state = state;
    this.stageReady = false;
    this.busy = false;
    this.over = false;
    /** @type {string | null} */
    this.shown = null;
    /** How the pen stands. @type {any} */
    this.pen = {};
    /** The end of the requests under way. @type {Promise<unknown>} */
    this.line = Promise.resolve();
    this.problem = "";
    this.told = 0;
    const words = JSON.parse(document.getElementById("drawing-words")?.textContent ?? "{}");
    this.words = words;
    this.own = speaker(words.script, needs.language);
    this.hintLine = /** @type {HTMLElement} */ (root.querySelector("#draw-hint"));
    this.slider = /** @type {HTMLInputElement} */ (root.querySelector("#draw-speed"));
    root.addEventListener("click", (event) => this.clicked(event));
    this.slider.addEventListener("input", () => this.needs.tell({ do: "speed", value: this.chosenSpeed() }));
    this.onKey = (/** @type {KeyboardEvent} */ event) => this.key(event);
    this.onHidden = () => document.hidden && this.interrupted("hidden");
    this.onDialog = () => this.interrupted("hidden");
    document.addEventListener("keydown", this.onKey);
    document.addEventListener("visibilitychange", this.onHidden);
    document.addEventListener("opened", this.onDialog);
    /** Advances the bar of the drive. @type {ReturnType<typeof setInterval> | undefined} */
    this.clock = undefined;
    this.show();
    this.interrupted("connection"); // a drive that was shown before the page was loaded is seen by nobody any more
  }

  /** Takes the drawing off the page. */
  leave() {
    this.over = true;
    clearInterval(this.clock);
    document.removeEventListener("keydown", this.onKey);
    document.removeEventListener("visibilitychange", this.onHidden);
    document.removeEventListener("opened", this.onDialog);
    this.needs.cover(null);
  }

  /** @param {TrialState} state as the server sees it now */
  update(state) {
    this.state = { ...this.state, ...state };
    if (!this.busy) this.show();
  }

  /** @param {StageMessage & Record<string, any>} message */
  hear(message) {
    const { cover, say } = this.needs;
    switch (message.type) {
      case "state":
        if (message.ready) this.setReady();
        break;
      case "ready":
        this.setReady();
        break;
      case "drawing":
        this.penMoved(message);
        break;
      case "stroke":
        this.send(message);
        break;
      case "playing":
        this.run();
        break;
      case "played":
        this.driven(message.playback_id);
        break;
      case "interrupted":
        if (message.playback_id === this.state.playback_id) this.interrupted(REASONS[message.reason ?? ""] ?? "connection");
        break;
      case "connection-lost":
        this.stageReady = false;
        cover(say("reconnecting"));
        this.interrupted("connection");
        break;
      case "webgl-lost":
        this.stageReady = false;
        cover(say("picture_lost"));
        this.interrupted("webgl_lost").then(() => this.needs.reloadStage());
        break;
      case "webgl-missing":
        cover(say("picture_missing"));
        break;
      case "replaced":
        this.needs.moveOut();
        break;
    }
  }

  setReady() {
    if (!this.stageReady) this.needs.notice("stage_ready");
    this.stageReady = true;
    this.needs.cover(null);
    this.needs.tell({ do: "words", words: { ...this.words.stage, language: this.needs.language } });
    if (!this.busy) this.show();
  }

  // ---- the pen -----------------------------------------------------------------------------------------------------

  /** @param {any} pen how it stands */
  penMoved(pen) {
    const sections = pen.can_undo !== this.pen.can_undo || pen.length_m !== this.pen.length_m;
    this.pen = pen;
    if (pen.drawing || sections) this.problem = "";
    const [low, high] = pen.speeds ?? [0.1, 0.25];
    this.slider.value = String(Math.round((100 * (pen.speed - low)) / (high - low)));
    this.slider.setAttribute("aria-valuetext", `${this.number(pen.speed, 2)} m/s`);
    if (this.state.phase === "drawing") this.showPen();
    const near = pen.tight ?? pen.near;
    const now = performance.now();
    if (pen.keys && near && now - this.told > ANNOUNCE_EVERY_MS) {
      this.told = now;
      this.needs.announce(this.own("here", { words: this.nearWords(near) }));
    }
  }

  showPen() {
    const { can_undo: undo, can_redo: redo, can_finish: finish, length_m: length } = this.pen;
    this.rest("undo", !undo);
    this.rest("redo", !redo);
    this.rest("clear", !length);
    this.rest("finish", !finish);
    const tight = this.pen.tight;
    if (!this.stageReady) return;
    let text = this.own("ask");
    if (this.problem) text = this.problem;
    else if (length) {
      text = this.own("drawn", { metres: this.number(length, 1), seconds: Math.round(this.pen.seconds) });
      if (tight) text += ` · ${this.nearWords(tight)}`;
      else if (finish && !this.pen.at_goal) text = this.own("go_on");
    }
    if (this.hintLine.textContent !== text) this.hintLine.textContent = text;
    this.hintLine.toggleAttribute("data-attention", Boolean(this.problem || (tight && length)));
  }

  /** @param {{name: string, metres: number}} near */
  nearWords(near) {
    const stage = this.words.stage;
    const kind = near.metres < 0 ? "would_hit" : near.metres < 0.08 ? "too_close" : "room_left";
    return String(stage[kind][near.name] ?? "").replace("{metres}", this.number(near.metres, 2));
  }

  /** @param {number} value @param {number} digits */
  number(value, digits) {
    return value.toLocaleString(this.needs.language, { minimumFractionDigits: digits, maximumFractionDigits: digits });
  }

  chosenSpeed() {
    const [low, high] = this.pen.speeds ?? [0.1, 0.25];
    return low + (Number(this.slider.value) / 100) * (high - low);
  }

  /** A finished stroke goes to the server, which keeps it whatever comes of it. @param {Record<string, any>} stroke */
  async send({ id, points, speeds, times_s, pointer }) {
    if (id !== this.needs.key || this.state.phase !== "drawing" || this.busy) return;
    const body = { request_id: newRequestId(), points, speeds, times_s, pointer, client_time: new Date().toISOString() };
    await this.work(async () => {
      const answered = await this.needs.post("stroke", body);
      if (answered.problem) this.tellProblem(answered.problem);
      return answered;
    });
  }

  /** @param {Record<string, any>} problem */
  tellProblem(problem) {
    const known = Object.keys(this.words.script.problems);
    const thing = problem.thing === "person" && this.root.dataset.view !== "top_down" ? "you" : problem.thing;
    this.problem = this.own(`problems.${known.includes(problem.code) ? problem.code : "other"}`, {
      thing: this.words.stage.would_hit[thing] ?? this.words.stage.would_hit.wall,
      distance: this.number(problem.distance_m ?? 0, 1),
      seconds: Math.round(problem.duration_s ?? 0),
    });
    this.needs.tell({ do: "problem", at: problem.at, text: problem.thing ? this.words.stage.would_hit[thing] : "" });
    this.needs.announce(this.problem);
  }

  // ---- the drive ---------------------------------------------------------------------------------------------------

  get driving() {
    return this.state.phase === "driving";
  }

  /** The stage has driven the path to its end. @param {string} [playbackId] */
  async driven(playbackId) {
    await this.work(async () => {
      if (this.state.playback_id !== playbackId) await this.needs.refresh();
      if (!this.driving || this.state.playback_id !== playbackId) return undefined;
      for (let tries = 0; ; tries += 1) {
        try {
          return await this.needs.post("driven", { playback_id: playbackId });
        } catch (error) {
          const early = error instanceof Refused && error.code === "too_early";
          if (!early || tries >= EARLY_TRIES || this.over) throw error;
          await pause(EARLY_WAIT_MS);
        }
      }
    });
  }

  /** @param {"hidden" | "connection" | "webgl_lost"} reason */
  async interrupted(reason) {
    if (!this.driving) return;
    await this.work(async () => (this.driving ? this.needs.post("interrupted", { reason }) : undefined));
    this.needs.announce(this.own("stopped"));
  }

  // ---- the bar -----------------------------------------------------------------------------------------------------

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (!button || this.busy) return;
    if (button.getAttribute("aria-disabled") === "true") {
      if (button.dataset.do === "finish") this.needs.announce(this.own("resting"));
      return;
    }
    const { do: what } = button.dataset;
    if (what) this.needs.tell({ do: what === "undo" && this.problem ? "cut" : what });
    else if ("redraw" in button.dataset) this.work(() => this.needs.post("redraw", {}), "redrawn");
    else if ("watch" in button.dataset) this.work(() => this.needs.post("drive", {}));
    else if ("keep" in button.dataset) this.decide({ stroke: this.state.stroke });
    else if ("skip" in button.dataset) this.decide({ skipped: true });
  }

  /** @param {object} value */
  async decide(value) {
    this.busy = true;
    this.part("sending");
    try {
      await this.needs.answer(value);
    } finally {
      this.busy = false;
      if (!this.over) this.show();
    }
  }

  /**
   * One request after the other; whatever it answers, the page then shows the server's state.
   * @param {() => Promise<any>} request @param {string} [said] announced afterwards
   */
  async work(request, said) {
    const before = this.line;
    /** @type {() => void} */
    let done = () => {};
    this.line = new Promise((resolve) => (done = () => resolve(undefined)));
    await before;
    this.busy = true;
    try {
      if (!this.over) {
        const answered = await request();
        if (answered?.step?.key === this.needs.key) this.state = { ...this.state, ...answered.step.trial };
        else await this.needs.refresh();
        if (said) this.needs.announce(this.own(said));
      }
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      await this.needs.refresh();
    } finally {
      this.busy = false;
      done();
      if (!this.over) this.show();
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (this.state.phase !== "drawing" || document.querySelector("dialog[open]")) return;
    const { target } = event;
    if (target instanceof HTMLTextAreaElement || target instanceof HTMLInputElement) return;
    const undo = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z";
    if (!undo && (event.ctrlKey || event.metaKey || event.altKey || !PEN_KEYS.includes(event.key))) return;
    if (event.key === "Enter" && target instanceof HTMLButtonElement) return;
    event.preventDefault();
    if (undo) this.needs.tell({ do: event.shiftKey ? "redo" : "undo" });
    else this.needs.tell({ do: "key", key: event.key, shift: event.shiftKey });
  }

  /** Draws the phase. */
  show() {
    const { phase } = this.state;
    const changed = phase !== this.shown;
    this.shown = phase;
    this.part(phase);
    this.slider.disabled = phase !== "drawing";
    for (const name of ["undo", "redo", "clear"]) this.rest(name, true);
    if (phase === "drawing") this.showPen();
    if (!changed) return;
    clearInterval(this.clock);
    if (phase === "driving") this.needs.announce(this.own("driving"));
    if (phase === "watched") {
      window.focus(); // takes the keyboard back from the stage
      /** @type {HTMLElement | null} */ (this.root.querySelector("#keep-question"))?.focus({ preventScroll: true });
    }
    if (phase === "drawing") this.hintLine.focus({ preventScroll: true });
  }

  /** @param {string} name of the phase */
  part(name) {
    this.root.dataset.shown = name;
    for (const part of /** @type {NodeListOf<HTMLElement>} */ (this.root.querySelectorAll("[data-phase]"))) {
      part.hidden = part.dataset.phase !== name;
    }
  }

  /** @param {string} name @param {boolean} resting */
  rest(name, resting) {
    this.root.querySelector(`[data-do="${name}"]`)?.setAttribute("aria-disabled", String(resting));
  }

  /** The robot has begun to move: the bar follows the drive's own length. */
  run() {
    const length = this.state.duration_s;
    if (!length) return;
    const bar = /** @type {HTMLProgressElement} */ (this.root.querySelector("#driving-progress"));
    const began = performance.now();
    clearInterval(this.clock);
    this.clock = setInterval(() => {
      bar.value = Math.min(1, (performance.now() - began) / 1000 / length);
    }, 100);
  }
}
