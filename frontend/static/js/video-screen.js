// @ts-check
/**
 * Videos in the stage's place: plays what the server says is playing, from its beginning to its end, without controls. It
 * speaks to the bar as the stage does, so a trial of videos is a trial like any other.
 */

/** @typedef {import("./stage-frame.js").StageMessage} StageMessage */

export class VideoScreen {
  /**
   * @param {{a: string, b: string}} addresses of the two videos
   * @param {(letter: string) => string} name what a screen reader calls one
   * @param {(message: StageMessage) => void} tell the bar
   */
  constructor(addresses, name, tell) {
    this.addresses = addresses;
    this.name = name;
    this.tell = tell;
    this.holder = /** @type {HTMLElement} */ (document.getElementById("stage-frame"));
    /** What is being shown. @type {string | null} */
    this.shown = null;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.wait = undefined;
    this.clear();
  }

  /** @param {{phase: string, playback_id?: string | null, label_s?: number}} state as the server sees it */
  follow({ phase, playback_id: id, label_s: labelS }) {
    const side = phase === "playing_a" ? "a" : phase === "playing_b" ? "b" : null;
    const wanted = side ? id ?? null : null;
    if (wanted === this.shown) return;
    this.clear();
    this.shown = wanted;
    if (!side || !wanted) return;
    const letter = side.toUpperCase();
    const video = document.createElement("video");
    video.src = `${this.addresses[side]}?shown=${wanted}`;
    video.preload = "auto";
    video.playsInline = true;
    video.disablePictureInPicture = true;
    video.setAttribute("aria-label", this.name(letter));
    video.addEventListener("contextmenu", (event) => event.preventDefault());
    video.addEventListener("playing", () => this.tell({ type: "playing", playback_id: wanted }), { once: true });
    video.addEventListener("ended", () => this.tell({ type: "played", playback_id: wanted }));
    video.addEventListener("error", () => this.tell({ type: "interrupted", playback_id: wanted, reason: "video" }));
    const label = document.createElement("p");
    label.className = "video-letter";
    label.textContent = labelS ? letter : "";
    label.hidden = !labelS;
    this.holder.replaceChildren(video, label);
    this.tell({ type: "label", playback_id: wanted });
    this.wait = setTimeout(() => {
      label.hidden = true;
      void this.play(video);
    }, 1000 * (labelS ?? 0));
  }

  /** Browsers that let nothing sound show it silently. @param {HTMLVideoElement} video */
  async play(video) {
    try {
      await video.play();
    } catch (error) {
      if (!(error instanceof DOMException) || error.name !== "NotAllowedError") return; // `error` was told already
      video.muted = true;
      await video.play().catch(() => this.tell({ type: "interrupted", playback_id: this.shown ?? undefined, reason: "video" }));
    }
  }

  /** An empty screen. */
  clear() {
    clearTimeout(this.wait);
    this.shown = null;
    const video = this.holder.querySelector("video");
    video?.pause();
    video?.removeAttribute("src");
    this.holder.replaceChildren();
  }
}
