// @ts-check
/**
 * A previewed step: the participants' own scripts, with a stand-in for the server that plays the trajectories, stores nothing
 * and goes on to the next page.
 */

import { kindModule } from "./kind.js";
import { pageData, speaker } from "./say.js";
import { NO_HEADSET } from "./stage-bar.js";
import { StageFrame } from "./stage-frame.js";

const data = pageData();
const say = speaker(data.texts, data.language);
const step = /** @type {HTMLElement} */ (document.getElementById("step"));

async function goOn() {
  location.assign(data.next);
}

/** @param {string} text for screen readers */
function announce(text) {
  const live = document.getElementById("live");
  if (live) live.textContent = text;
}

/** @param {string | null} text laid over the stage */
function cover(text) {
  const over = document.getElementById("stage-cover");
  const words = document.getElementById("stage-cover-text");
  if (!over || !words) return;
  over.hidden = text === null;
  if (text !== null) words.textContent = text;
}

/** What stood above and below the stage in the participant's window, pixels of the same style sheet. */
const BARS_PX = 52 + 108;

/**
 * The picture in the shape that it had in the participant's window, as large as it fits: a view from the eyes shows more or
 * less of the room in another one.
 * @param {[number, number]} seen width and height of that window
 */
function fit([width, height]) {
  const room = /** @type {HTMLElement} */ (document.getElementById("stage"));
  const frame = /** @type {HTMLElement} */ (document.getElementById("stage-frame"));
  const ratio = width / Math.max(1, height - BARS_PX);
  new ResizeObserver(() => {
    const w = Math.min(room.clientWidth, room.clientHeight * ratio);
    const h = w / ratio;
    Object.assign(frame.style, { width: `${w}px`, height: `${h}px` });
    Object.assign(frame.style, { left: `${(room.clientWidth - w) / 2}px`, top: `${(room.clientHeight - h) / 2}px` });
  }).observe(room);
}

let restarts = 0;

/** @param {import("./contract.js").Seen["side"]} side */
async function play(side) {
  if (data.videos) return { phase: `playing_${side}`, playback_id: `${side}${restarts}`, label_s: 1 };
  const answer = await fetch(`/lab/preview-stage/${data.stage_token}/${side}`, {
    method: "POST",
    headers: { "X-CSRF": data.csrf },
  });
  if (!answer.ok) location.reload();
  return { phase: `playing_${side}`, playback_id: side };
}

/**
 * What the server would say.
 * @param {string} path @param {any} body
 */
async function post(path, body) {
  let trial;
  if (path === "rollout") trial = { ...(await play("a")), phase: "driving" };
  else if (data.state) trial = data.state; // a drawing: nothing can be drawn anew, only watched again
  else if (path === "start") trial = await play("a");
  else if (path === "seen") trial = body.side === "a" && data.durations.length > 1 ? await play("b") : { phase: "choosing" };
  else trial = { phase: "ready", restarts: (restarts += 1) };
  return { step: { key: data.key, trial } };
}

/** @type {import("./kind.js").Bar | undefined} */
let bar;
const stage = new StageFrame(
  /** @type {HTMLElement} */ (document.getElementById("stage-frame")),
  data.stage_origin,
  (message) => bar?.hear(message),
);
const onStage = Boolean(step.querySelector(".trialbar"));
// what is shown on the stage, where an example of it can be
const shown = onStage && data.durations.length > 0;
document.body.dataset.layout = shown ? "stage" : "text";
const way = step.querySelector("#live-way");
if (way && !shown) way.textContent = data.running_only;
if (shown || !onStage) {
  const module = await kindModule(data.kind);
  const mounted = module.mount({
    step,
    key: data.key,
    state: /** @type {any} as much of it as an example has */ (
      data.state ?? { phase: "ready", restarts: 0, videos: data.videos, duration_a_s: data.durations[0], duration_b_s: data.durations[1] }
    ),
    language: data.language,
    say,
    answer: goOn,
    keep: () => {},
    kept: null,
    page: {
      refresh: async () => {},
      announce,
      cover: data.stage_token || data.videos ? cover : () => {},
      headset: NO_HEADSET, reloadStage: () => stage.reload(), greetStage: () => stage.greet(),
      moveOut: () => location.assign(data.next),
      notice: () => {}, // a preview leaves no trace in the log
    },
    poster: () => post,
    tell: (order) => stage.draw(order),
    toStage: () => {},
  });
  bar = mounted?.bar;
}
if (shown && data.window) fit(data.window);
if (shown && data.stage_token) stage.open(`${data.stage_origin}/stage/${data.stage_token}/`, data.stage_title);
