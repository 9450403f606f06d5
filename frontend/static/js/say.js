// @ts-check
/** Texts of the page's JSON block, with their braces filled the way backend/desirepath/web/core/catalogues.py fills them. */

/** @typedef {import("./types.js").Table} Table */

/**
 * @param {Table} texts
 * @param {string} language
 * @returns {(key: string, values?: Record<string, string | number>) => string}
 */
export function speaker(texts, language) {
  const plurals = new Intl.PluralRules(language);
  const numbers = new Intl.NumberFormat(language);
  return (key, values = {}) => {
    /** @type {string | Table | undefined} */
    let entry = texts;
    for (const part of key.split(".")) entry = typeof entry === "object" ? entry[part] : undefined;
    if (typeof entry === "object") entry = entry[plurals.select(Number(values.count))] ?? entry.other;
    if (typeof entry !== "string") throw new Error(`no text ${key} on this page`);
    return entry.replace(/\{([a-z_][a-z0-9_]*)\}/g, (_, name) => {
      const value = values[name];
      if (value === undefined) throw new Error(`text ${key} needs a value for ${name}`);
      return typeof value === "number" ? numbers.format(value) : value;
    });
  };
}

/** The page's JSON block. @returns {any} */
export function pageData() {
  const block = document.getElementById("page-data");
  return JSON.parse(block?.textContent ?? "{}");
}
