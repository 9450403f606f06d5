// @ts-check
/**
 * What every kind of step's module is: `kinds/KIND.js` exports `mount`, and what the page must know before it. The page
 * finds it by the kind's name; no list of kinds stands anywhere. Shapes and the finding; what a kind does is its own.
 */

import { fetchText } from "./send.js";

/** @typedef {import("./stage-bar.js").StageNeeds} StageNeeds */

/** @typedef {import("./types.js").Kind} Kind */

/**
 * @template {Kind} [K=any] its kind: `KindPage<"rating">` knows what a rating's answer is and how its trial is told
 * @typedef {object} KindPage what a kind gets from the page
 * @property {HTMLElement} step
 * @property {string} key
 * @property {import("./types.js").ProgressOf<K>} state of its trial or drawing, as the kind's own server side says it
 * @property {string} language
 * @property {(key: string, values?: Record<string, string | number>) => string} say
 * @property {(value: import("./types.js").AnswerTo<K>) => Promise<void>} answer
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

/** How often a script that came as text but not as a module is asked for before the page is loaded anew. */
const TRIES = 3;

/**
 * The module of a kind; lost connections are waited out, as with everything that is asked of the server.
 * @param {string} kind @returns {Promise<KindModule>}
 */
export async function kindModule(kind) {
  for (let tries = 0; tries < TRIES; tries += 1) {
    try {
      // a browser remembers that an import failed, so every further try has an address of its own
      return await import(`./kinds/${kind}.js${tries ? `?again=${tries}` : ""}`);
    } catch {
      await fetchText(`/static/js/kinds/${kind}.js`);
    }
  }
  location.reload();
  return new Promise(() => {});
}

/**
 * A page with a form: what `questions.js` readies.
 * @template {Kind} K
 * @param {KindPage<K>} page
 * @returns {import("./questions.js").FormNeeds<import("./types.js").AnswerTo<K>>}
 */
export function formNeeds({ say, answer, keep, kept }) {
  return { say, answer, keep, kept };
}

/** @template {Kind} K @param {KindPage<K>} page @param {string} room @returns {StageNeeds} */
export function stageNeeds({ key, answer, say, page, poster }, room) {
  return { key, answer: /** @type {(value: any) => Promise<void>} bars type what they send */ (answer), say, ...page, post: poster(room) };
}
