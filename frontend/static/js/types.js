// @ts-check
/**
 * Shapes that the server and the scripts share; no code lives here.
 *
 * @typedef {"ready" | "playing_a" | "playing_b" | "choosing" | "answered" | "drawing" | "driving" | "watched"} Phase
 *
 * @typedef {object} TrialState
 * @property {Phase} phase
 * @property {number} [duration_a_s]
 * @property {number} [duration_b_s]
 * @property {number} [label_s]
 * @property {number} [replays] how often both drives were watched again
 * @property {number} [restarts] how often this trial had to begin again
 * @property {"a" | "b"} [next_side] which drive Start plays: B where only B was cut short
 * @property {string | null} [playback_id] what is playing now
 * @property {number | null} [duration_s] of the drive of a drawn path
 * @property {string | null} [stroke] the drawn path that can be kept
 * @property {boolean} [met] whether the robot met the participant on the last walk
 * @property {boolean} [walking] whether the participant walks beside the drive
 *
 * @typedef {object} StepState
 * @property {string} key
 * @property {string} kind
 * @property {number} index counted from 0
 * @property {number} total
 * @property {TrialState | null} [trial]
 *
 * @typedef {object} SessionState what `GET /api/session/{token}` answers, and every POST beside its own things
 * @property {"active" | "paused" | "completed" | "withdrawn" | "expired" | "screened_out"} state
 * @property {StepState | null} step
 * @property {string} language
 * @property {string} [stage_url] where the step is a trial
 *
 * @typedef {{[key: string]: string | Table}} Table texts by key, nested
 *
 * @typedef {object} PageData the JSON block of the page
 * @property {string} token
 * @property {SessionState} state
 * @property {string} stage_origin
 * @property {Table} texts
 * @property {string} language
 */

export {};
