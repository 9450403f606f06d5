// @ts-check
/**
 * The bar of a trial: Start, A, B, choice. It shows what the server says; it decides nothing. Drives that were cut short
 * are reported to the server, which decides where the trial goes on.
 */

import { Refused, newRequestId, pause } from "./send.js";

/** @typedef {import("./types.js").TrialState} TrialState */
/** @typedef {import("./types.js").Phase} Phase */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

/**
 * @typedef {object} TrialNeeds what the trial gets from the page
 * @property {string} key of the step
 * @property {(path: string, body: object) => Promise<any>} post to `/api/session/TOKEN/trials/KEY/PATH`
 * @property {(value: object) => Promise<void>} answer sends the choice and moves on
 * @property {() => Promise<void>} refresh asks the server where the session stands
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(text: string) => void} announce to screen readers
 * @property {(text: string | null) => void} cover lays a sentence over the stage, null takes it away
 * @property {() => void} reloadStage
 * @property {ReturnType<typeof import("./notice.js").noticer>} notice to the server's log
 * @property {() => void} moveOut another window has taken over
 */

/** The server's clock and ours differ a little: a `seen` that came too early is sent again after this. */
const EARLY_WAIT_MS = 400;
const EARLY_TRIES = 25;
const SLOW_STAGE_MS = 25000;

/** Why the stage stopped a drive, in the words of the server. @type {Record<string, "hidden" | "connection" | "webgl_lost">} */
const REASONS = { "tab-hidden": "hidden", "webgl-lost": "webgl_lost" };

export class Trial {
  /**
   * @param {HTMLElement} root the bar
   * @param {TrialState} state
   * @param {TrialNeeds} needs
   */
  constructor(root, state, needs) {
    this.root = root;
    this.needs = needs;
    this.state = state;
    this.stageReady = false;
    this.busy = false;
    this.over = false;
    /** The end of the requests under way. @type {Promise<unknown>} */
    this.line = Promise.resolve();
    this.cutting = false;
    /** @type {Phase | null} */
    this.shown = null;
    this.start = /** @type {HTMLButtonElement} */ (root.querySelector("#start"));
    this.picks = /** @type {NodeListOf<HTMLButtonElement>} */ (root.querySelectorAll("[data-choice]"));
    /** How the pair may be watched, as the protocol says. */
    this.rules = {
      replays: Number(root.dataset.replays ?? 0),
      early: "earlyChoice" in root.dataset,
      limitS: Number(root.dataset.choiceLimit ?? 0),
    };
    /** Whether drive B has begun to move. */
    this.sawB = false;
    this.again = /** @type {HTMLButtonElement | null} */ (root.querySelector("#again"));
    this.again?.addEventListener("click", () => this.watchAgain());
    this.start.addEventListener("click", () => this.begin());
    for (const pick of this.picks) pick.addEventListener("click", () => this.choose(pick));
    this.onKey = (/** @type {KeyboardEvent} */ event) => this.key(event);
    this.onHidden = () => document.hidden && this.interrupted("hidden");
    // behind a dialog nobody sees the drive
    this.onDialog = () => this.interrupted("hidden");
    document.addEventListener("keydown", this.onKey);
    document.addEventListener("visibilitychange", this.onHidden);
    document.addEventListener("opened", this.onDialog);
    this.slow = setTimeout(() => this.tellSlow(), SLOW_STAGE_MS);
    /** Advances the bar of the drive that plays. @type {ReturnType<typeof setInterval> | undefined} */
    this.clock = undefined;
    this.show();
    // A drive that was playing when the page was loaded is not seen by anybody any more.
    this.interrupted("connection");
  }

  /** Takes the trial off the page. */
  leave() {
    this.over = true;
    clearTimeout(this.slow);
    document.removeEventListener("keydown", this.onKey);
    document.removeEventListener("visibilitychange", this.onHidden);
    document.removeEventListener("opened", this.onDialog);
    clearInterval(this.clock);
    this.needs.cover(null);
  }

  /** @param {TrialState} state as the server sees it now */
  update(state) {
    this.state = { ...this.state, ...state };
    if (!this.busy) this.show();
  }

  /** @param {StageMessage} message */
  hear(message) {
    const { cover, say } = this.needs;
    switch (message.type) {
      case "state":
        if (message.ready) this.setReady();
        break;
      case "ready":
        this.setReady();
        break;
      case "playing":
        this.run();
        break;
      case "played":
        this.seen(message.playback_id);
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
        this.stageReady = false;
        cover(say("picture_missing"));
        this.interrupted("webgl_lost");
        break;
      case "replaced":
        this.needs.moveOut();
        break;
      case "key":
        this.press(message.key ?? "");
        break;
    }
  }

  tellSlow() {
    if (this.stageReady) return;
    this.hint("preparing_slow");
    this.needs.notice("stage_slow");
  }

  setReady() {
    if (!this.stageReady) this.needs.notice("stage_ready");
    this.stageReady = true;
    this.needs.cover(null);
    if (!this.busy) this.show();
  }

  get playing() {
    return this.state.phase === "playing_a" || this.state.phase === "playing_b";
  }

  get mayChoose() {
    return this.state.phase === "choosing" || (this.rules.early && this.sawB && this.state.phase === "playing_b");
  }

  async watchAgain() {
    if (this.busy || this.state.phase !== "choosing") return;
    await this.work(() => this.needs.post("again", { request_id: newRequestId() }));
  }

  async begin() {
    if (this.busy || this.state.phase !== "ready") return;
    if (!this.stageReady) {
      this.needs.announce(this.needs.say("preparing"));
      return;
    }
    await this.work(() => this.needs.post("start", { request_id: newRequestId() }));
  }

  /** The stage has played a drive to its end. @param {string} [playbackId] */
  async seen(playbackId) {
    await this.work(async () => {
      // The news can be faster than the answer to Start that says what is playing.
      if (this.state.playback_id !== playbackId) await this.needs.refresh();
      if (!this.playing || this.state.playback_id !== playbackId) return undefined;
      const drive = this.state.phase === "playing_b" ? "b" : "a";
      for (let tries = 0; ; tries += 1) {
        try {
          return await this.needs.post("seen", { drive, playback_id: playbackId });
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
    if (!this.playing || this.cutting) return;
    this.cutting = true;
    try {
      await this.work(async () => (this.playing ? this.needs.post("interrupted", { reason }) : undefined));
    } finally {
      this.cutting = false;
    }
  }

  /** @param {HTMLButtonElement} pick */
  async choose(pick) {
    if (this.busy) return;
    if (!this.mayChoose) {
      this.needs.announce(this.needs.say(this.rules.early ? "resting_early" : "resting"));
      return;
    }
    const choice = pick.dataset.choice ?? "";
    pick.dataset.chosen = "";
    this.needs.announce(this.needs.say("chosen", { letter: choice.toUpperCase() }));
    await this.send({ choice });
    if (!this.over) delete pick.dataset.chosen;
  }

  /** @param {{choice: string} | {timed_out: true}} value */
  async send(value) {
    this.busy = true;
    this.rest(true);
    this.part("sending");
    try {
      await this.needs.answer(value);
    } finally {
      this.busy = false;
      if (!this.over) this.show();
    }
  }

  /** Where the protocol gives the choice a time: says what is left, and goes on when it is over. */
  limitChoice() {
    const until = performance.now() + this.rules.limitS * 1000;
    clearInterval(this.clock);
    const look = () => {
      const left = Math.ceil((until - performance.now()) / 1000);
      this.text("#choice-left", this.needs.say("choice_left", { count: Math.max(0, left) }));
      if (left > 0 || this.busy) return;
      clearInterval(this.clock);
      this.needs.announce(this.needs.say("choice_over"));
      void this.send({ timed_out: true });
    };
    this.clock = setInterval(look, 200);
    look();
  }

  /**
   * One request after the other; whatever it answers, the page then shows the server's state.
   * @param {() => Promise<any>} request
   */
  async work(request) {
    const before = this.line;
    /** @type {() => void} */
    let done = () => {};
    this.line = new Promise((resolve) => (done = () => resolve(undefined)));
    await before;
    this.busy = true;
    try {
      if (!this.over) {
        const answered = await request();
        const trial = answered?.step?.trial ?? answered?.trial;
        if (trial && answered.step?.key === this.needs.key) this.state = { ...this.state, ...trial };
        else await this.needs.refresh();
      }
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      await this.needs.refresh();
    } finally {
      this.busy = false;
      done();
      if (!this.over) this.show();
      // hidden while the request was under way: the drive that began meanwhile was not seen
      if (!this.over && document.hidden) this.interrupted("hidden");
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (document.querySelector("dialog[open]")) return;
    if (event.target instanceof HTMLTextAreaElement || event.target instanceof HTMLInputElement) return;
    if (this.press(event.key)) {
      event.preventDefault();
    } else if ((event.key === "Enter" || event.key === " ") && event.target === document.body) {
      // the focus was on nothing: the main button is meant
      event.preventDefault();
      this.begin();
    }
  }

  /** A letter, pressed here or while the stage had the focus. @param {string} key @returns {boolean} */
  press(key) {
    const pick = [...this.picks].find((button) => button.dataset.choice === key.toLowerCase());
    if (pick) this.choose(pick);
    return pick !== undefined;
  }

  /** Draws the phase. */
  show() {
    const { phase, duration_a_s: a, duration_b_s: b, restarts } = this.state;
    const { say, announce } = this.needs;
    const changed = phase !== this.shown;
    this.shown = phase;
    if (changed) this.sawB = false;
    this.rest(!this.mayChoose);
    if (phase === "ready") {
      this.part("ready");
      this.start.setAttribute("aria-disabled", String(!this.stageReady));
      if (this.stageReady) {
        // One figure for both drives: two would tell them apart before they were seen.
        const label = this.state.label_s ?? 0;
        let what = say("ready");
        if (this.state.next_drive === "b" && b) what = say("ready_b", { seconds: Math.round(b + label) });
        else if (a && b) what = say("ready_durations", { seconds: Math.round(a + b + 2 * label) });
        this.text("#start-hint-text", restarts ? `${say(this.state.next_drive === "b" ? "restarted_b" : "restarted")} ${what}` : what);
        if (changed && restarts) announce(say(this.state.next_drive === "b" ? "restarted_b" : "restarted"));
      } else {
        this.hint("preparing");
      }
      if (changed || document.activeElement === document.body) this.start.focus({ preventScroll: true });
    } else if (phase === "playing_a" || phase === "playing_b") {
      const letter = phase === "playing_a" ? "A" : "B";
      this.part("playing");
      this.text("#playing-letter", letter);
      this.text("#playing-text", say("playing", { letter }));
      if (changed) {
        this.rewind();
        announce(say("playing", { letter }));
      }
    } else if (phase === "choosing") {
      this.part("choosing");
      if (changed) {
        // also takes the keyboard back from the stage, in which the participant may have looked around
        window.focus();
        /** @type {HTMLElement | null} */ (this.root.querySelector("#question"))?.focus({ preventScroll: true });
        announce(say("choose"));
        if (this.rules.limitS) this.limitChoice();
      }
      if (this.again) this.again.hidden = (this.state.replays ?? 0) >= this.rules.replays;
    } else {
      this.part("sending");
    }
  }

  /** @param {"ready" | "playing" | "choosing" | "sending"} name */
  part(name) {
    for (const part of /** @type {NodeListOf<HTMLElement>} */ (this.root.querySelectorAll("[data-phase]"))) {
      part.hidden = part.dataset.phase !== name;
    }
  }

  /** @param {boolean} resting */
  rest(resting) {
    for (const pick of this.picks) {
      pick.setAttribute("aria-disabled", String(resting));
      if (resting) pick.setAttribute("aria-describedby", "resting");
      else pick.removeAttribute("aria-describedby");
    }
  }

  /** The robot has begun to move: the bar follows the drive's own length. */
  run() {
    this.sawB = this.state.phase === "playing_b";
    this.rest(!this.mayChoose);
    const length = this.state.phase === "playing_b" ? this.state.duration_b_s : this.state.duration_a_s;
    if (!length) return;
    const bar = /** @type {HTMLProgressElement} */ (this.root.querySelector("#playing-progress"));
    const began = performance.now();
    clearInterval(this.clock);
    this.clock = setInterval(() => {
      bar.value = Math.min(1, (performance.now() - began) / 1000 / length);
    }, 100);
  }

  /** The bar at its beginning. */
  rewind() {
    clearInterval(this.clock);
    /** @type {HTMLProgressElement} */ (this.root.querySelector("#playing-progress")).value = 0;
  }

  /** @param {string} key */
  hint(key) {
    this.text("#start-hint-text", this.needs.say(key));
  }

  /** @param {string} selector @param {string} text */
  text(selector, text) {
    const element = this.root.querySelector(selector);
    if (element && element.textContent !== text) element.textContent = text;
  }
}
