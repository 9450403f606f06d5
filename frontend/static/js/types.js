// @ts-check
/**
 * Shapes of the page itself; no code lives here. What is sent and received in JSON is in contract.d.ts, which is made from the
 * server's models.
 *
 * @typedef {import("./contract.js").SessionState} SessionState
 * @typedef {import("./contract.js").TrialState} TrialState
 * @typedef {import("./contract.js").DrawingState} DrawingState
 * @typedef {{phase: "live", playback_id: null}} LiveState weights are changed by hand; the page itself knows how far it is
 * @typedef {TrialState | DrawingState | LiveState} BarState what a bar under the stage shows
 *
 * @typedef {import("./contract.js").StepNow} StepNow
 * @typedef {NonNullable<import("./contract.js").AnswerSent["kind"]>} Kind of step, as the server's folder of kinds has them
 */
/**
 * @template {Kind} K
 * @typedef {NonNullable<Extract<StepNow, {kind: K}>["trial"]>} ProgressOf how far a step of that kind is
 */
/**
 * @template {Kind} K
 * @typedef {NonNullable<Extract<import("./contract.js").AnswerSent, {kind?: K}>["value"]>} AnswerTo what is answered there
 */
/**
 *
 * @typedef {{[key: string]: string | Table}} Table texts by key, nested
 *
 * @typedef {object} PageData the JSON block of the page
 * @property {string} token
 * @property {SessionState} state
 * @property {string} stage_origin
 * @property {"offered" | "required" | null} headset whether the study is seen with one
 * @property {"silent" | "offered" | "heard"} motor_sound
 * @property {boolean} head_pose whether it is stored how the head moves in it
 * @property {Table} texts
 * @property {string} language
 */

export {};
