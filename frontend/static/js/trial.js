// @ts-check
/**
 * The bar of a trial: Start, A, B, choice. It shows what the server says; it decides nothing. Trajectories that were cut short
 * are reported to the server, which decides where the trial goes on.
 */

import { newRequestId } from "./send.js";
import { StageBar } from "./stage-bar.js";
import { VideoScreen } from "./video-screen.js";

/** @typedef {import("./contract.js").TrialState} TrialState */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

const SLOW_STAGE_MS = 25000;

/** @extends {StageBar<TrialState>} */
export class Trial extends StageBar {
  /**
   * @param {HTMLElement} root the bar
   * @param {TrialState} state
   * @param {import("./stage-bar.js").StageNeeds} needs
   */
  constructor(root, state, needs) {
    super(root, state, needs);
    this.start = /** @type {HTMLButtonElement} */ (root.querySelector("#start"));
    this.picks = /** @type {NodeListOf<HTMLButtonElement>} */ (root.querySelectorAll("[data-choice]"));
    /** How the pair may be watched, as the protocol says. */
    this.rules = {
      replays: Number(root.dataset.replays ?? 0),
      early: "earlyChoice" in root.dataset,
      limitS: Number(root.dataset.choiceLimit ?? 0),
    };
    /** How clearly one is better, where that is asked after the choice. */
    this.degrees = /** @type {NodeListOf<HTMLButtonElement>} */ (root.querySelectorAll("[data-degree]"));
    /** What was chosen, while it is asked how clearly. @type {HTMLButtonElement | null} */
    this.picked = null;
    /** Whether Start was pressed before the stage stood: then it counts as soon as it does. */
    this.pressedEarly = false;
    /** Whether trajectory B has begun to move. */
    this.sawB = false;
    this.again = /** @type {HTMLButtonElement | null} */ (root.querySelector("#again"));
    this.again?.addEventListener("click", () => this.watchAgain());
    this.start.addEventListener("click", () => this.startTrajectories());
    for (const pick of this.picks) pick.addEventListener("click", () => this.choose(pick));
    for (const degree of this.degrees) degree.addEventListener("click", () => this.grade(degree));
    this.slow = setTimeout(() => this.tellSlow(), SLOW_STAGE_MS);
    const videos = /** @type {{a: string, b: string} | null | undefined} */ (state.videos);
    /** Shows videos in the stage's place. @type {VideoScreen | null} */
    this.screen = videos ? new VideoScreen(videos, (letter) => needs.say("video", { letter }), (message) => this.hear(message)) : null;
    if (this.screen) this.setReady();
    this.begin();
  }

  /** Takes the trial off the page. */
  leave() {
    clearTimeout(this.slow);
    this.screen?.clear();
    super.leave();
  }

  /** @param {StageMessage} message */
  hear(message) {
    super.hear(message);
    if (message.type === "key") this.press(message.key ?? "");
  }

  tellSlow() {
    if (this.stageReady) return;
    this.hint("preparing_slow");
    this.needs.notice("stage_slow");
  }

  watch() {
    super.watch();
    if (!this.over) this.screen?.follow(this.state);
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

  async startTrajectories() {
    if (this.busy || this.state.phase !== "ready") return;
    const missing = this.needs.headset.missing;
    if (missing) {
      this.needs.announce(missing);
      return;
    }
    if (!this.stageReady) {
      this.pressedEarly = true;
      this.needs.announce(this.needs.say("preparing"));
      return;
    }
    this.pressedEarly = false;
    await this.work(() => this.needs.post("start", { request_id: newRequestId() }));
  }

  /** @param {StageMessage} message */
  played({ playback_id: id, headset = null }) {
    this.reportPlayed(id, () => {
      /** @type {import("./contract.js").Seen} */
      const body = { side: this.state.phase === "playing_b" ? "b" : "a", headset };
      return { path: "seen", body };
    });
  }

  /** @param {HTMLButtonElement} pick */
  async choose(pick) {
    if (this.busy) return;
    if (!this.mayChoose) {
      this.needs.announce(this.needs.say(this.rules.early ? "resting_early" : "resting"));
      return;
    }
    const letter = (pick.dataset.choice ?? "").toUpperCase();
    for (const other of this.picks) delete other.dataset.chosen;
    pick.dataset.chosen = "";
    if (pick.dataset.choice === "none") {
      await this.answer(pick, { degree: "no_difference" });
      return;
    }
    this.needs.announce(this.needs.say("chosen", { letter }));
    if (this.degrees.length) {
      this.picked = pick;
      this.part("degree");
      const asked = /** @type {HTMLElement} */ (this.root.querySelector("#degree-question"));
      asked.textContent = (asked.dataset.asked ?? "").replace("*", letter);
      asked.focus({ preventScroll: true });
    } else {
      await this.answer(pick, { choice: /** @type {"a" | "b"} */ (pick.dataset.choice) });
    }
  }

  /** @param {HTMLButtonElement} degree */
  async grade(degree) {
    if (this.busy || !this.picked) return;
    const said = { choice: /** @type {"a" | "b"} */ (this.picked.dataset.choice), degree: /** @type {"slight" | "clear"} */ (degree.dataset.degree) };
    await this.answer(this.picked, said);
  }

  /**
   * @param {HTMLButtonElement} pick
   * @param {import("./types.js").AnswerTo<"trial">} said
   */
  async answer(pick, said) {
    this.rest(true);
    /** @type {import("./types.js").AnswerTo<"trial" | "comparison" | "method_comparison">} */
    const value = { ...said, ...(this.playing ? { hmd: this.needs.headset.worn } : {}) };
    await this.decide(value);
    if (!this.over) delete pick.dataset.chosen;
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
      this.rest(true);
      /** @type {import("./types.js").AnswerTo<"trial">} */
      const value = { timed_out: true };
      void this.decide(value);
    };
    this.clock = setInterval(look, 200);
    look();
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
      this.startTrajectories();
    }
  }

  /** A letter or number, pressed here or while the stage had the focus. @param {string} key @returns {boolean} */
  press(key) {
    const pick = [...this.picks].find((button) => (button.dataset.key ?? button.dataset.choice) === key.toLowerCase());
    const degree = this.picked && [...this.degrees].find((button) => button.dataset.key === key);
    if (pick) this.choose(pick);
    else if (degree) this.grade(degree);
    return Boolean(pick ?? degree);
  }

  /** Draws the phase. */
  show() {
    const { phase, duration_a_s: a, duration_b_s: b, restarts } = this.state;
    const { say, announce } = this.needs;
    const changed = phase !== this.shown;
    this.shown = phase;
    if (changed) this.sawB = false;
    if (phase === "ready" || phase === "playing_a") {
      if (this.picked) delete this.picked.dataset.chosen;
      this.picked = null;
    }
    this.rest(!this.mayChoose);
    if (phase === "ready") {
      this.part("ready");
      const missing = this.needs.headset.missing;
      this.start.setAttribute("aria-disabled", String(!this.stageReady || missing !== null));
      if (missing) this.text("#start-hint-text", missing);
      else if (this.stageReady) {
        // One figure for both trajectories: two would tell them apart before they were seen.
        const label = this.state.label_s ?? 0;
        let what = say("ready");
        if (this.state.next_side === "b" && b) what = say("ready_b", { seconds: Math.round(b + label) });
        else if (a && b) what = say("ready_durations", { seconds: Math.round(a + b + 2 * label) });
        this.text("#start-hint-text", restarts ? `${say(this.state.next_side === "b" ? "restarted_b" : "restarted")} ${what}` : what);
        if (changed && restarts) announce(say(this.state.next_side === "b" ? "restarted_b" : "restarted"));
      } else {
        this.hint("preparing");
      }
      if (changed || document.activeElement === document.body) this.start.focus({ preventScroll: true });
      if (this.stageReady && this.pressedEarly) void this.startTrajectories();
    } else if (phase === "playing_a" || phase === "playing_b") {
      const letter = phase === "playing_a" ? "A" : "B";
      this.part(this.picked ? "degree" : "playing");
      this.text("#playing-letter", letter);
      this.text("#playing-text", say("playing", { letter }));
      if (changed) {
        this.rewind("#playing-progress");
        announce(say("playing", { letter }));
      }
    } else if (phase === "choosing") {
      this.part(this.picked ? "degree" : "choosing");
      if (changed && this.rules.limitS) this.limitChoice();
      if (changed && !this.picked) {
        // also takes the keyboard back from the stage, in which the participant may have looked around
        window.focus();
        /** @type {HTMLElement | null} */ (this.root.querySelector("#question"))?.focus({ preventScroll: true });
        announce(say("choose"));
      }
      if (this.again) this.again.hidden = (this.state.replays ?? 0) >= this.rules.replays;
    } else {
      this.part("sending");
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

  /** The robot has begun to move: the bar follows the trajectory's own length. */
  run() {
    this.sawB = this.state.phase === "playing_b";
    this.rest(!this.mayChoose);
    this.follow("#playing-progress", this.state.phase === "playing_b" ? this.state.duration_b_s : this.state.duration_a_s);
  }

  /** @param {string} key */
  hint(key) {
    this.text("#start-hint-text", this.needs.say(key));
  }
}
