// @ts-check
/**
 * What must survive a reload of this tab: an answer that is not acknowledged yet, and the choices made in a form that is
 * not sent yet. Session storage only, removed as soon as the server has the answer: computers are shared.
 */

/**
 * @typedef {object} Pending
 * @property {string} url
 * @property {object} body
 */

/** @param {string} token of the session; every session keeps its own things */
export function keeper(token) {
  const pendingKey = `desirepath.pending.${token}`;
  const draftKey = (/** @type {string} */ step) => `desirepath.draft.${token}.${step}`;

  return {
    /** @param {Pending} pending */
    hold(pending) {
      write(pendingKey, pending);
    },
    /** @returns {Pending | null} */
    held: () => read(pendingKey),
    release: () => remove(pendingKey),
    /** @param {string} step @param {Record<string, unknown>} values */
    draft(step, values) {
      write(draftKey(step), values);
    },
    /** @param {string} step @returns {Record<string, unknown> | null} */
    drafted: (step) => read(draftKey(step)),
    /** @param {string} step */
    forget: (step) => remove(draftKey(step)),
  };
}

// Storage can be switched off in a browser; then nothing is kept, and everything else still works.

/** @param {string} key @param {unknown} value */
function write(key, value) {
  try {
    sessionStorage.setItem(key, JSON.stringify(value));
  } catch {
    /* see above */
  }
}

/** @param {string} key @returns {any} */
function read(key) {
  try {
    return JSON.parse(sessionStorage.getItem(key) ?? "null");
  } catch {
    return null;
  }
}

/** @param {string} key */
function remove(key) {
  try {
    sessionStorage.removeItem(key);
  } catch {
    /* see above */
  }
}
