// @ts-check
/**
 * What every bar under the stage shares: it hears the stage, tells the server one thing after the other, shows what the
 * server says, and reports trajectories that were cut short. What stands in the bar is trial.js's, single.js's and drawing.js's.
 */

import { Refused, pause } from "./send.js";

/** @typedef {import("./types.js").BarState} BarState */
/** @typedef {import("./contract.js").Interrupted["reason"]} Cut */
/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

/**
 * @typedef {object} StageNeeds what a bar gets from the page
 * @property {string} key of the step
 * @property {(path: string, body: object) => Promise<any>} post to the step's own address
 * @property {(value: object) => Promise<void>} answer sends the step's answer and moves on
 * @property {() => Promise<void>} refresh asks the server where the session stands
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(text: string) => void} announce to screen readers
 * @property {(text: string | null) => void} cover lays a sentence over the stage, null takes it away
 * @property {{worn: boolean, missing: string | null, used: import("./contract.js").HeadsetUsed | null}} headset
 * @property {() => void} reloadStage
 * @property {() => void} greetStage asks the stage how it is; it answers with `state`
 * @property {ReturnType<typeof import("./notice.js").noticer>} notice to the server's log
 * @property {() => void} moveOut another window has taken over
 */

/** The server's clock and ours differ a little: what came too early is sent again after this. */
const EARLY_WAIT_MS = 400;
const EARLY_TRIES = 25;

/** A ready stage that has not begun with what the server plays is asked so often, so far apart; then the order is lost. */
const LOST_AFTER_MS = 15000;
const LOST_AFTER_ASKING = 2;

/** Of pages where no headset can be put on. @type {StageNeeds["headset"]} */
export const NO_HEADSET = { worn: false, missing: null, used: null };

/** Why the stage stopped a trajectory, in the words of the server. @type {Record<string, Cut>} */
const REASONS = { "tab-hidden": "hidden", "webgl-lost": "webgl_lost", headset: "hidden" };

/** @template {BarState} S how the server sees what is shown */
export class StageBar {
  /**
   * @param {HTMLElement} root the bar
   * @param {S} state
   * @param {StageNeeds} needs
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
    /** @type {S["phase"] | null} */
    this.shown = null;
    /** What the stage has begun with. @type {string | null | undefined} */
    this.begun = null;
    /** Rings where the stage does not begin. @type {ReturnType<typeof setTimeout> | undefined} */
    this.alarm = undefined;
    /** What the alarm is set for. @type {string | null} */
    this.awaited = null;
    /** What the stage was asked about. @type {string | null} */
    this.asking = null;
    this.missed = 0;
    /** Advances the bar of the trajectory that plays. @type {ReturnType<typeof setInterval> | undefined} */
    this.clock = undefined;
    this.onKey = (/** @type {KeyboardEvent} */ event) => this.key(event);
    this.onHidden = () => this.hidden && this.interrupted("hidden");
    // behind a dialog nobody sees the trajectory
    this.onDialog = () => this.interrupted("hidden");
    document.addEventListener("keydown", this.onKey);
    document.addEventListener("visibilitychange", this.onHidden);
    document.addEventListener("opened", this.onDialog);
  }

  /** To be called when the bar stands. A trajectory that played when the page was loaded is seen by nobody any more. */
  begin() {
    this.show();
    this.interrupted("connection");
  }

  /** Takes the bar off the page. */
  leave() {
    this.over = true;
    clearInterval(this.clock);
    clearTimeout(this.alarm);
    document.removeEventListener("keydown", this.onKey);
    document.removeEventListener("visibilitychange", this.onHidden);
    document.removeEventListener("opened", this.onDialog);
    this.needs.cover(null);
  }

  /** @param {S} state as the server sees it now */
  update(state) {
    this.state = { ...this.state, ...state };
    if (!this.busy) this.show();
    this.watch();
  }

  /** Nobody waits for what will never play: a stage that does not begin is loaded anew, and the trajectory with it. */
  watch() {
    const awaited = this.playing && this.stageReady && !this.over ? this.state.playback_id : null;
    if (awaited === this.awaited) return;
    clearTimeout(this.alarm);
    this.awaited = awaited;
    if (!awaited) return;
    this.missed = 0;
    this.ringLater();
  }

  /** After a while the stage is asked what it plays; a slow one just answers late. */
  ringLater() {
    this.alarm = setTimeout(() => {
      this.asking = this.awaited;
      this.needs.greetStage();
    }, LOST_AFTER_MS);
  }

  /** The stage's answer, where it was asked. @param {StageMessage} message */
  answered(message) {
    const asked = this.asking;
    this.asking = null;
    if (!asked || asked !== this.awaited || this.begun === asked || this.over) return;
    if (message.playback_id === asked) this.begun = asked;
    else if ((this.missed += 1) < LOST_AFTER_ASKING) this.ringLater();
    else {
      this.stageReady = false;
      this.interrupted("connection").then(() => this.needs.reloadStage());
    }
  }

  /** Whether nobody sees the stage: in a headset the window does not matter. */
  get hidden() {
    return document.hidden && !this.needs.headset.worn;
  }

  /** Whether a trajectory is shown now. */
  get playing() {
    return false;
  }

  /** Draws the phase. */
  show() {}

  /** @param {KeyboardEvent} _event */
  key(_event) {}

  /** The robot has begun to move. */
  run() {}

  /** The server has taken a request. @param {any} _answered */
  taken(_answered) {}

  /** The stage has played a trajectory to its end. @param {StageMessage} _message */
  played(_message) {}

  /** @param {StageMessage} message */
  hear(message) {
    const { cover, say } = this.needs;
    switch (message.type) {
      case "state":
        if (message.ready) this.setReady();
        this.answered(message);
        break;
      case "ready":
        this.setReady();
        break;
      case "label":
        this.begun = message.playback_id;
        break;
      case "playing":
        this.begun = message.playback_id;
        this.run();
        break;
      case "played":
        this.played(message);
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
    }
  }

  setReady() {
    if (!this.stageReady) this.needs.notice("stage_ready");
    this.stageReady = true;
    this.needs.cover(null);
    if (!this.busy) this.show();
    this.watch();
  }

  /**
   * Tells the server that a trajectory was played, again where its clock says that it cannot have been yet.
   * @param {string | undefined} playbackId
   * @param {() => {path: string, body: object}} report what to send; asked once the page knows what is playing
   * @returns {Promise<boolean>} whether it was taken
   */
  async reportPlayed(playbackId, report) {
    const taken = await this.tellPlayed(playbackId, report);
    // Nothing plays any more: what was not taken (seen without the headset it needs, say) can be begun again.
    if (!taken && !this.over && this.state.playback_id === playbackId) await this.interrupted("connection");
    return taken;
  }

  /** @param {string | undefined} playbackId @param {() => {path: string, body: object}} report @returns {Promise<boolean>} */
  async tellPlayed(playbackId, report) {
    return this.work(async () => {
      // The news can be faster than the answer that says what is playing.
      if (this.state.playback_id !== playbackId) await this.needs.refresh();
      if (!this.playing || this.state.playback_id !== playbackId) return undefined;
      const { path, body } = report();
      for (let tries = 0; ; tries += 1) {
        try {
          return await this.needs.post(path, { playback_id: playbackId, ...body });
        } catch (error) {
          const early = error instanceof Refused && error.code === "too_early";
          if (!early || tries >= EARLY_TRIES || this.over) throw error;
          await pause(EARLY_WAIT_MS);
        }
      }
    });
  }

  /** @param {Cut} reason */
  async interrupted(reason) {
    if (!this.playing || this.cutting) return;
    this.cutting = true;
    try {
      await this.work(async () => (this.playing ? this.needs.post("interrupted", { reason }) : undefined));
    } finally {
      this.cutting = false;
    }
  }

  /**
   * One request after the other; whatever it answers, the page then shows the server's state.
   * @param {() => Promise<any>} request
   * @returns {Promise<boolean>} whether it was taken
   */
  async work(request) {
    const before = this.line;
    /** @type {() => void} */
    let done = () => {};
    this.line = new Promise((resolve) => (done = () => resolve(undefined)));
    await before;
    this.busy = true;
    try {
      if (this.over) return false;
      const answered = await request();
      const trial = answered?.step?.trial ?? answered?.trial;
      if (trial && answered.step?.key === this.needs.key) this.state = { ...this.state, ...trial };
      else await this.needs.refresh();
      this.taken(answered);
      return true;
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      await this.needs.refresh();
      return false;
    } finally {
      this.busy = false;
      done();
      if (!this.over) this.show();
      this.watch();
      // hidden while the request was under way: the trajectory that began meanwhile was not seen
      if (!this.over && this.hidden) this.interrupted("hidden");
    }
  }

  /** Sends the step's answer; the page moves on. @param {object} value */
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

  /** @param {string} name of the phase whose part is to be seen */
  part(name) {
    this.root.dataset.shown = name;
    const parts = /** @type {HTMLElement[]} */ ([...this.root.querySelectorAll("[data-phase]")]);
    const left = parts.find((part) => !part.hidden && part.dataset.phase !== name && part.contains(document.activeElement));
    for (const part of parts) part.hidden = part.dataset.phase !== name;
    const shown = left && parts.find((part) => !part.hidden);
    if (!shown) return;
    // what had the focus is hidden now: it stays in the bar, at the part that took its place
    shown.tabIndex = -1;
    shown.focus({ preventScroll: true });
  }

  /** @param {string} selector @param {string} text */
  text(selector, text) {
    const element = this.root.querySelector(selector);
    if (element && element.textContent !== text) element.textContent = text;
  }

  /** A progress bar follows a trajectory's own length from now on. @param {string} selector @param {number | null} [seconds] */
  follow(selector, seconds) {
    if (!seconds) return;
    const bar = /** @type {HTMLProgressElement} */ (this.root.querySelector(selector));
    const began = performance.now();
    clearInterval(this.clock);
    this.clock = setInterval(() => {
      bar.value = Math.min(1, (performance.now() - began) / 1000 / seconds);
    }, 100);
  }

  /** The progress bar at its beginning. @param {string} selector */
  rewind(selector) {
    clearInterval(this.clock);
    /** @type {HTMLProgressElement} */ (this.root.querySelector(selector)).value = 0;
  }
}
