// @ts-check
/**
 * What every kind of step's module is: `kinds/KIND.js` exports `mount`, and what the page must know before it. The page
 * finds it by the kind's name; no list of kinds stands anywhere. Shapes and the finding; what a kind does is its own.
 */

/** @typedef {import("./stage-bar.js").StageNeeds} StageNeeds */

/**
 * @typedef {object} KindPage what a kind gets from the page
 * @property {HTMLElement} step
 * @property {string} key
 * @property {any} state of its trial or drawing, as the kind's own server side says it
 * @property {string} language
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(value: object) => Promise<void>} answer
 * @property {(values: Record<string, unknown>) => void} keep
 * @property {Record<string, unknown> | null} kept
 * @property {Omit<StageNeeds, "key" | "answer" | "say" | "post">} page
 * @property {(room: string) => StageNeeds["post"]} poster to the step's own addresses below `room`
 * @property {(order: any) => void} tell the stage something
 * @property {() => void} toStage moves the keyboard there
 */

/**
 * @typedef {object} Bar what stands under the stage
 * @property {(state: any) => void} update
 * @property {(message: import("./stage-frame.js").StageMessage) => void} hear
 * @property {() => void} leave
 */

/**
 * @typedef {object} Mounted
 * @property {Bar} [bar]
 * @property {(job: import("./contract.js").JobNews) => void} [job] hears how far the training is
 */

/**
 * @typedef {object} KindModule
 * @property {boolean} [longText] says that there is more below until its end has come into sight
 * @property {boolean} [last] nothing comes after it, and nothing can be paused any more
 * @property {(page: KindPage) => Mounted | void} mount
 */

/** @param {string} kind @returns {Promise<KindModule>} */
export function kindModule(kind) {
  return import(`./kinds/${kind}.js`);
}

/** A page with a form: what `questions.js` readies. @param {KindPage} page */
export function formNeeds({ say, answer, keep, kept }) {
  return { say, answer, keep, kept };
}

/** @param {KindPage} page @param {string} room @returns {StageNeeds} */
export function stageNeeds({ key, answer, say, page, poster }, room) {
  return { key, answer, say, ...page, post: poster(room) };
}
