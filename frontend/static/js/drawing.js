// @ts-check
/**
 * The bar under a drawing: undo, speed, let the robot drive, walk, keep, draw again. The pen itself is the stage's
 * (app/desirepath_stage/client/draw.js), the feet too (walk.js); what becomes of a stroke is the server's. Nothing that was drawn is lost:
 * a stroke goes to the server before anything.
 */

import { newRequestId } from "./send.js";
import { speaker } from "./say.js";
import { StageBar } from "./stage-bar.js";

/** @typedef {import("./contract.js").DrawingState} DrawingState */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */
/** @typedef {import("./contract.js").PenState} PenState */

/**
 * @typedef {object} DrawingNeeds what a drawing gets from the page beside what every bar gets
 * @property {(order: object) => void} tell the stage's pen and feet
 * @property {() => void} toStage gives the stage the keyboard
 * @property {string} language
 */

const ANNOUNCE_EVERY_MS = 1500;

/** @extends {StageBar<DrawingState>} */
export class Drawing extends StageBar {
  /**
   * @param {HTMLElement} root the bar
   * @param {DrawingState} state
   * @param {import("./stage-bar.js").StageNeeds & DrawingNeeds} needs
   */
  constructor(root, state, needs) {
    super(root, state, needs);
    const { tell, toStage, language } = needs;
    this.tell = tell;
    this.toStage = toStage;
    this.language = language;
    /** How the pen stands. @type {Partial<PenState>} */
    this.pen = {};
    /** Which keys the stage wants to hear of, as it says itself. @type {{pen: string[], feet: string[]}} */
    this.keys = { pen: [], feet: [] };
    this.problem = "";
    this.bar = "#driving-progress";
    this.announcedAt = 0;
    const words = JSON.parse(document.getElementById("drawing-words")?.textContent ?? "{}");
    this.words = words;
    this.own = speaker(words.script, language);
    this.walkText = root.querySelector("#walking-text")?.textContent ?? "";
    this.hintLine = /** @type {HTMLElement} */ (root.querySelector("#draw-hint"));
    this.walkButtons = /** @type {NodeListOf<HTMLButtonElement>} */ (root.querySelectorAll("[data-walk]"));
    this.slider = /** @type {HTMLInputElement} */ (root.querySelector("#draw-speed"));
    root.addEventListener("click", (event) => this.clicked(event));
    this.slider.addEventListener("input", () => this.tell({ do: "speed", value: this.chosenSpeed() }));
    this.onKeyUp = (/** @type {KeyboardEvent} */ event) => this.step(event, false);
    document.addEventListener("keyup", this.onKeyUp);
    this.begin();
  }

  /** Takes the drawing off the page. */
  leave() {
    document.removeEventListener("keyup", this.onKeyUp);
    super.leave();
  }

  /** @param {StageMessage & Record<string, any>} message */
  hear(message) {
    super.hear(message);
    if (!this.stageReady) this.restShowing(true);
    if (message.keys) this.keys = message.keys;
    if (message.type === "drawing") this.penMoved(/** @type {any} */ (message));
    else if (message.type === "stroke") this.send(message);
  }

  setReady() {
    this.tell({ do: "words", words: { ...this.words.stage, language: this.language } });
    super.setReady();
  }

  // ---- the pen -----------------------------------------------------------------------------------------------------

  /** @param {PenState} pen how it stands */
  penMoved(pen) {
    const sections = pen.can_undo !== this.pen.can_undo || pen.length_m !== this.pen.length_m;
    this.pen = pen;
    if (pen.drawing || (sections && !pen.problem)) this.problem = "";
    const [low, high] = pen.speeds;
    this.slider.value = String(Math.round((100 * (pen.speed - low)) / (high - low)));
    this.slider.setAttribute("aria-valuetext", `${this.number(pen.speed, 2)} m/s`);
    if (this.state.phase === "drawing") this.showPen();
    const near = pen.tight ?? pen.near;
    const now = performance.now();
    if (pen.keys && near && now - this.announcedAt > ANNOUNCE_EVERY_MS) {
      this.announcedAt = now;
      this.needs.announce(this.own("here", { words: this.nearWords(near) }));
    }
  }

  showPen() {
    const { can_undo: undo, can_redo: redo, can_finish: finish, length_m: length } = this.pen;
    this.rest("undo", !undo);
    this.rest("redo", !redo);
    this.rest("clear", !length);
    this.rest("finish", !finish || this.needs.headset.missing !== null);
    for (const button of this.walkButtons) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.walk) === this.pen.walk));
    }
    const tight = this.pen.tight;
    if (!this.stageReady) return;
    const { worn, missing } = this.needs.headset;
    let text = this.own(worn ? "ask_headset" : "ask");
    if (missing) text = missing;
    else if (this.problem) text = this.problem;
    else if (this.pen.must_choose) text = this.own("choose_walk");
    else if (length) {
      text = this.own("drawn", { metres: this.number(length, 1), seconds: Math.round(this.pen.seconds ?? 0) });
      if (tight) text += ` · ${this.nearWords(tight)}`;
      else if (finish && !this.pen.at_goal) text = this.own("go_on");
    }
    if (this.hintLine.textContent !== text) this.hintLine.textContent = text;
    this.hintLine.toggleAttribute("data-attention", Boolean(this.problem || (tight && length)));
  }

  /** @param {{name: string, metres: number, tight: boolean}} near */
  nearWords(near) {
    const stage = this.words.stage;
    const kind = near.metres < 0 ? "would_hit" : near.tight ? "too_close" : "room_left";
    return String(stage[kind][near.name] ?? "").replace("{metres}", this.number(near.metres, 2));
  }

  /** @param {number} value @param {number} digits */
  number(value, digits) {
    return value.toLocaleString(this.language, { minimumFractionDigits: digits, maximumFractionDigits: digits });
  }

  chosenSpeed() {
    const [low, high] = this.pen.speeds ?? [0, 0];
    return low + (Number(this.slider.value) / 100) * (high - low);
  }

  /** A finished stroke goes to the server, which keeps it whatever comes of it. @param {Record<string, any>} stroke */
  async send({ id, points, speeds, times_s, pointer, walk, headset }) {
    if (id !== this.needs.key || this.state.phase !== "drawing" || this.busy) return;
    if (this.needs.headset.missing) return this.needs.announce(this.needs.headset.missing);
    const client_time = new Date().toISOString();
    /** @type {import("./contract.js").StrokeSent} */
    const body = { request_id: newRequestId(), points, speeds, times_s, pointer, walk, headset, client_time };
    await this.work(() => this.needs.post("stroke", body));
  }

  /** @param {import("./contract.js").DrawingReply | undefined} answered */
  taken(answered) {
    if (answered?.problem) this.tellProblem(answered.problem);
  }

  /** @param {import("./contract.js").StrokeProblemState} problem */
  tellProblem(problem) {
    const known = Object.keys(this.words.script.problems);
    const walks = this.root.dataset.person === "walks";
    const you = walks || this.root.dataset.view !== "top_down";
    const thing = problem.thing === "person" && you ? "you" : (problem.thing ?? "");
    const met = problem.thing === "person" && problem.after_s !== undefined;
    const code = met ? (walks ? "met_you" : "met_person") : problem.code;
    this.problem = this.own(`problems.${known.includes(code) ? code : "other"}`, {
      thing: this.words.stage.would_hit[thing] ?? this.words.stage.would_hit.wall,
      distance: this.number(problem.distance_m ?? 0, 1),
      seconds: Math.round(problem.duration_s ?? problem.after_s ?? 0),
    });
    this.tell({ do: "problem", code: problem.code, at: problem.at, text: problem.thing ? this.words.stage.would_hit[thing] : "" });
    this.needs.announce(this.problem);
  }

  // ---- the rollout -------------------------------------------------------------------------------------------------

  get playing() {
    return this.state.phase === "driving";
  }

  /** Whether the participant walks beside this rollout. */
  get walking() {
    return this.playing && Boolean(this.state.walking);
  }

  /** @param {StageMessage & Record<string, any>} message */
  async played({ playback_id: id, walk, headset = null }) {
    await this.reportPlayed(id, () => ({ path: "rollout-seen", body: walk ? { walk, headset } : { headset } }));
  }

  /** @param {import("./contract.js").Interrupted["reason"]} reason */
  async interrupted(reason) {
    if (!this.playing) return;
    await super.interrupted(reason);
    this.needs.announce(this.own("stopped"));
  }

  // ---- the bar -----------------------------------------------------------------------------------------------------

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (!button || this.busy) return;
    if (button.getAttribute("aria-disabled") === "true") {
      if (button.dataset.do === "finish") this.needs.announce(this.own("resting"));
      else if (!this.stageReady) this.needs.announce(this.needs.say("preparing"));
      return;
    }
    const { do: what } = button.dataset;
    // The very same path once more, beside which the participant walks another way.
    if (what === "finish" && this.state.met && !this.pen.can_undo) this.walkAgain();
    else if (what) this.tell({ do: what === "undo" && this.problem ? "cut" : what });
    else if (button.dataset.walk) this.tell({ do: "choose", walk: Number(button.dataset.walk) });
    else if (button.dataset.look) this.look(button.dataset.look);
    else if ("redraw" in button.dataset) this.redraw();
    else if ("walkAgain" in button.dataset) this.walkAgain();
    else if ("watch" in button.dataset) this.work(() => this.needs.post("rollout", {}));
    else if ("keep" in button.dataset) this.keep({ stroke: this.state.stroke });
    else if ("skip" in button.dataset) this.keep({ skipped: true });
  }

  /** @param {import("./types.js").AnswerTo<"demonstration">} which path, or that no further one is wanted */
  keep(which) {
    void this.decide(which);
  }

  walkAgain() {
    return this.work(() => this.needs.post("walk", { request_id: newRequestId() }));
  }

  async redraw() {
    if (await this.work(() => this.needs.post("redraw", {}))) this.needs.announce(this.own("redrawn"));
  }

  /** Where both are watched from. @param {string} from above or side */
  look(from) {
    this.tell({ do: "look", from });
    for (const button of /** @type {NodeListOf<HTMLElement>} */ (this.root.querySelectorAll("[data-look]"))) {
      button.setAttribute("aria-pressed", String(button.dataset.look === from));
    }
  }

  /** A key for the feet, pressed or let go while the page had the focus. @param {KeyboardEvent} event @param {boolean} down @returns {boolean} */
  step(event, down) {
    if (!this.walking || event.ctrlKey || event.metaKey || event.altKey) return false;
    if (!this.keys.feet.includes(event.key.length === 1 ? event.key.toLowerCase() : event.key)) return false;
    this.tell({ do: "step", key: event.key, down });
    return true;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (document.querySelector("dialog[open]")) return;
    if (this.step(event, true)) event.preventDefault();
    if (this.state.phase !== "drawing") return;
    const { target } = event;
    if (target instanceof HTMLTextAreaElement || target instanceof HTMLInputElement) return;
    const undo = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z";
    if (!undo && (event.ctrlKey || event.metaKey || event.altKey || !this.keys.pen.includes(event.key))) return;
    if (event.key === "Enter" && target instanceof HTMLButtonElement) return;
    event.preventDefault();
    if (undo) this.tell({ do: event.shiftKey ? "redo" : "undo" });
    else this.tell({ do: "key", key: event.key, shift: event.shiftKey });
  }

  /** Draws the phase. */
  show() {
    const { phase } = this.state;
    const changed = phase !== this.shown;
    this.shown = phase;
    this.bar = this.walking ? "#walking-progress" : "#driving-progress";
    this.part(this.walking ? "walking" : phase);
    this.slider.disabled = phase !== "drawing";
    for (const name of ["undo", "redo", "clear"]) this.rest(name, true);
    this.restShowing(!this.stageReady);
    if (phase === "drawing") this.showPen();
    if (!changed) return;
    clearInterval(this.clock);
    if (phase === "driving") {
      this.needs.announce(this.own(this.walking ? (this.needs.headset.worn ? "walk_headset" : "walk") : "driving"));
      this.rewind(this.bar);
      if (this.walking) this.toStage();
      else this.look("above");
    }
    if (this.walking) {
      this.text("#walking-text", this.needs.headset.worn ? this.own("walk_headset") : this.walkText);
    }
    if (phase === "watched") {
      window.focus(); // takes the keyboard back from the stage
      /** @type {HTMLElement | null} */ (this.root.querySelector("#keep-question"))?.focus({ preventScroll: true });
    }
    if (phase === "drawing") this.hintLine.focus({ preventScroll: true });
  }

  /** @param {string} name @param {boolean} resting */
  rest(name, resting) {
    this.root.querySelector(`[data-do="${name}"]`)?.setAttribute("aria-disabled", String(resting));
  }

  /** A rollout that is asked for before the stage stands would be interrupted by its arrival. @param {boolean} resting */
  restShowing(resting) {
    for (const button of this.root.querySelectorAll("[data-watch], [data-walk-again]")) {
      button.setAttribute("aria-disabled", String(resting));
    }
  }

  /** The robot has begun to move. */
  run() {
    this.follow(this.bar, this.state.duration_s);
  }
}
