// @ts-check
/**
 * Sends on how the head moves in a headset, part by part in their order, each until it is acknowledged; the server counts a
 * part once. What a lost connection leaves waiting is bounded. Not a participant's business: refusals are not shown.
 */

import { Refused, ask } from "./send.js";

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

const MOST_WAITING = 240; // parts, twenty minutes; then the oldest is let go

export class HeadPoses {
  /** @param {string} url of the room @param {() => string | undefined} step the session is at, none where it shows no room */
  constructor(url, step) {
    this.url = url;
    this.step = step;
    this.key = "";
    /** @type {{key: string, body: import("./contract.js").HeadMoved}[]} */
    this.waiting = [];
    this.sending = false;
  }

  /** @param {StageMessage} message */
  hear({ type, head }) {
    if (type !== "head" || !head) return;
    this.key = this.step() ?? this.key; // who reads a page with the headset on still stands in the room before
    this.waiting.push({ key: this.key, body: head });
    if (this.waiting.length > MOST_WAITING) this.waiting.shift();
    if (!this.sending) void this.send();
  }

  async send() {
    this.sending = true;
    try {
      for (let next = this.waiting.shift(); next; next = this.waiting.shift()) {
        try {
          await ask(`${this.url}/${encodeURIComponent(next.key)}`, next.body);
        } catch (error) {
          if (!(error instanceof Refused)) throw error;
        }
      }
    } finally {
      this.sending = false;
    }
  }
}
