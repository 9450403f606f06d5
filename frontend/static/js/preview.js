// @ts-check
/**
 * A previewed step: the participants' own scripts, with a stand-in for the server that plays the drives, stores nothing
 * and goes on to the next page.
 */

import { readyForm } from "./questions.js";
import { pageData, speaker } from "./say.js";
import { StageFrame } from "./stage-frame.js";
import { Trial } from "./trial.js";

const data = pageData();
const say = speaker(data.texts, data.language);
const step = /** @type {HTMLElement} */ (document.getElementById("step"));
const bar = /** @type {HTMLElement | null} */ (document.getElementById("trial"));

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

if (bar) {
  document.body.dataset.layout = "stage";
  let restarts = 0;

  /** @param {"a" | "b"} drive */
  async function play(drive) {
    const answer = await fetch(`/lab/preview-stage/${data.stage_token}/${drive}`, {
      method: "POST",
      headers: { "X-CSRF": data.csrf },
    });
    if (!answer.ok) location.reload();
    return { phase: `playing_${drive}`, playback_id: drive };
  }

  /**
   * What the server would say.
   * @param {string} path @param {any} body
   */
  async function post(path, body) {
    let trial;
    if (path === "start") trial = await play("a");
    else if (path === "seen") trial = body.drive === "a" ? await play("b") : { phase: "choosing" };
    else trial = { phase: "ready", restarts: (restarts += 1) };
    return { step: { key: data.key, trial } };
  }

  /** @type {Trial | null} */
  let trial = null;
  const stage = new StageFrame(
    /** @type {HTMLElement} */ (document.getElementById("stage-frame")),
    data.stage_origin,
    (message) => trial?.hear(message),
  );
  trial = new Trial(
    bar,
    /** @type {any} */ ({ phase: "ready", restarts: 0, duration_a_s: data.durations?.[0], duration_b_s: data.durations?.[1] }),
    {
      key: data.key,
      post,
      answer: goOn,
      refresh: async () => {},
      say,
      announce,
      cover: data.stage_token ? cover : () => {},
      reloadStage: () => stage.reload(),
      moveOut: () => location.assign(data.next),
      notice: () => {}, // a preview leaves no trace in the log
    },
  );
  if (data.stage_token) stage.open(`${data.stage_origin}/stage/${data.stage_token}/`, data.stage_title);
} else {
  document.body.dataset.layout = "text";
  readyForm(step, data.kind, { say, answer: goOn, keep: () => {}, kept: null });
}
