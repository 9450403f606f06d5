// @ts-check
/**
 * The iframe that holds the 3D stage, and the messages it sends. Opened for the first trial, closed when a step needs
 * no stage (drawing a hidden room would take the computer's strength from the training that runs meanwhile).
 */

/**
 * @typedef {object} StageMessage
 * @property {string} type as app/desirepath_stage/page.py lists them
 * @property {string} [playback_id]
 * @property {boolean} [ready]
 * @property {string} [reason]
 * @property {string} [key]
 * @property {boolean} [on] a headset is worn
 * @property {boolean} [here] what is shown can be seen with one
 * @property {string | null} [why] no headset is worn
 * @property {string[]} [controllers]
 * @property {number | null} [refresh_rate]
 * @property {string} [id] of a button that was pressed in the room
 * @property {import("./contract.js").HeadMoved} [head] how the head moved, a few seconds of it
 * @property {number} [share] of a slider that is moved there, 0 to 1
 * @property {boolean} [settled] and has been let go
 * @property {import("./contract.js").HeadsetUsed | null} [headset] what was played was watched, or a button pressed, with
 */

export class StageFrame {
  /**
   * @param {HTMLElement} holder
   * @param {string} origin of the stage; messages from elsewhere are not listened to
   * @param {(message: StageMessage) => void} onMessage
   */
  constructor(holder, origin, onMessage) {
    this.holder = holder;
    this.origin = origin;
    /** @type {HTMLIFrameElement | null} */
    this.frame = null;
    addEventListener("message", (event) => {
      if (event.origin !== this.origin || !this.frame || event.source !== this.frame.contentWindow) return;
      if (event.data?.source === "desirepath-stage") onMessage(event.data);
    });
  }

  /** @param {string} url @param {string} title for screen readers */
  open(url, title) {
    if (this.frame?.src === new URL(url, location.href).href) {
      this.greet();
      return;
    }
    this.close();
    const frame = document.createElement("iframe");
    frame.src = url;
    frame.title = title;
    frame.allow = "fullscreen; xr-spatial-tracking; autoplay";
    frame.addEventListener("load", () => this.greet());
    this.holder.replaceChildren(frame);
    this.frame = frame;
  }

  /** Asks the stage how it is; it answers with a `state` message. */
  greet() {
    this.frame?.contentWindow?.postMessage({ type: "hello" }, this.origin);
  }

  /** Gives the stage the keyboard. */
  focus() {
    this.frame?.focus();
  }

  /** Orders for the stage's pen and feet (app/desirepath_stage/client/draw.js). @param {object} order */
  draw(order) {
    this.frame?.contentWindow?.postMessage({ type: "draw", ...order }, this.origin);
  }

  /** What the room shows to who wears a headset (app/desirepath_stage/client/headset.js). @param {object} order */
  headset(order) {
    this.frame?.contentWindow?.postMessage({ type: "headset", ...order }, this.origin);
  }

  /** Whether motors sound (app/desirepath_stage/client/sound.js). @param {object} order */
  sound(order) {
    this.frame?.contentWindow?.postMessage({ type: "sound", ...order }, this.origin);
  }

  /** Loads the stage anew, after its picture was lost. */
  reload() {
    const frame = this.frame;
    if (frame) frame.src = `${frame.src}`;
  }

  close() {
    this.holder.replaceChildren();
    this.frame = null;
  }
}
