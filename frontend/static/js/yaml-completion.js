// @ts-check
/** What may be written at a place of a protocol's YAML, by its JSON Schema and by what there is to name. Knows no editor. */

/**
 * @typedef {{ label: string, detail?: string, info?: string, type: "property" | "enum", apply?: string }} Option
 * @typedef {{ from: number, typing: boolean, options: Option[] }} Suggestions from: where the word begins; typing: only
 *   where it has begun
 */

/**
 * @param {string} before the text up to the cursor
 * @param {import("./protocol-editor.js").Known} known
 * @param {string} after the rest of the line
 * @returns {Suggestions | null}
 */
export function suggest(before, known, after = "") {
  const lines = before.split("\n");
  const line = /** @type {string} */ (lines.pop());
  if (/(^|\s)#/.test(line)) return null;
  const { path, key, word } = placeOf(lines, line);
  const from = before.length - word.length;
  const here = at(known.protocol, path);
  if (key === null) {
    const keys = here.flatMap((one) => [
      ...Object.entries(one.properties ?? {}),
      ...(one.propertyNames?.enum ?? []).map((/** @type {string} */ name) => /** @type {[string, any]} */ ([name, one.additionalProperties])),
    ]);
    const there = new Set(siblings(lines, line));
    const colon = after.trimStart().startsWith(":") ? "" : ": ";
    const options = keys.filter(([name]) => !there.has(name)).map(([name, of]) => keyOption(known.protocol, name, of, colon));
    return options.length ? { from, typing: !/^\s*(- )?$/.test(line) && !/[{,]\s*$/.test(line), options } : null;
  }
  const values = at(known.protocol, [...path, key]);
  const words = values.flatMap((one) => one.enum ?? (one.const === undefined ? [] : [one.const]));
  if (values.some((one) => one.type === "boolean")) words.push(true, false);
  const items = values.flatMap((one) => (one.type === "array" ? follow(known.protocol, one.items ?? {}) : []));
  words.push(...items.flatMap((one) => one.enum ?? []));
  const names = values.some((one) => one.type === "string") ? known.names[key] ?? [] : [];
  const options = [...words, ...names].map((value) => /** @type {Option} */ ({ label: String(value), type: "enum" }));
  return options.length ? { from, typing: false, options } : null;
}

/** @param {any} schema @param {string} name @param {any} of @param {string} colon @returns {Option} */
function keyOption(schema, name, of, colon) {
  const [first = {}] = follow(schema, of);
  const nested = first.type === "object" ? ":" : colon;
  const usual = of.default === undefined || of.default === null || typeof of.default === "object" ? "" : ` (${of.default})`;
  return { label: name, type: "property", apply: colon && name + nested, detail: `${first.type ?? ""}${usual}`, info: of.description ?? first.description };
}

/**
 * Where the cursor stands: `path` of the mapping or list around it; `key` whose value is written, null where a key is.
 * @param {string[]} lines before it
 * @param {string} line up to it
 */
export function placeOf(lines, line) {
  /** @type {(string | number)[]} */
  const path = [];
  const [, dashes, rest] = /** @type {RegExpExecArray} */ (/^(\s*(?:- +|-$){0,20})(.*)$/.exec(line));
  let column = dashes.length;
  for (const dash of [...dashes].map((one, at) => (one === "-" ? at : -1)).filter((at) => at >= 0).reverse()) {
    path.unshift(0);
    column = dash;
  }
  // a list's dash may stand as far right as its key
  let listed = path.length > 0;
  for (const above of [...lines].reverse()) {
    const match = /^(\s*)((?:- +){0,20})([\w-]+|"[^"]*"):(\s.*|)$/.exec(above);
    const item = /^(\s*)(-)(?: |$)/.exec(above);
    if (!above.trim() || above.trimStart().startsWith("#")) continue;
    const dashAt = item ? item[1].length : -1;
    if (match) {
      const keyAt = match[1].length + match[2].length;
      if (keyAt < column || (listed && keyAt === column && !match[2])) {
        const opens = !match[4].trim() || match[4].trim().startsWith("#") || match[4].trim().startsWith("&");
        if (opens) path.unshift(match[3].replaceAll('"', ""));
        else if (keyAt < column) return { path: ["?"], key: null, word: "" }; // below a value there is nothing
        column = keyAt;
        listed = false;
      }
    }
    if (dashAt >= 0 && dashAt < column) {
      path.unshift(0);
      column = dashAt;
      listed = true;
    }
    if (column === 0 && !listed) break;
  }
  // what is open on the line itself: `key:`, `{` and `[`
  let key = null;
  let word = "";
  /** @type {{ list: boolean }[]} */
  const opened = [];
  for (const [token] of rest.matchAll(/"[^"]*"?|'[^']*'?|[{}[\],]|:(?=\s|$)|\s+|[^\s{}[\],:]+|:/g)) {
    if (token === "{" || token === "[") {
      if (key !== null) path.push(key);
      if (token === "[") path.push(0);
      opened.push({ list: token === "[" });
      key = null;
      word = "";
    } else if (token === "}" || token === "]") {
      if (opened.pop()?.list) path.pop();
      key = typeof path.at(-1) === "string" ? String(path.pop()) : null;
      word = "";
    } else if (token === ",") {
      key = null;
      word = "";
    } else if (token === ":") {
      key = word.trim().replaceAll(/["']/g, "");
      word = "";
    } else if (!token.trim()) {
      if (word) word += token;
    } else word += token;
  }
  if (key === null && opened.at(-1)?.list) {
    path.pop();
    key = String(path.pop() ?? "");
  }
  return { path, key, word };
}

/** Keys that stand beside the cursor's already. @param {string[]} lines @param {string} line */
function siblings(lines, line) {
  const column = /^(\s*(?:- +)*)/.exec(line)?.[1].length ?? 0;
  /** @type {string[]} */
  const keys = [...line.matchAll(/\b(\w+):\s/g)].map(([, key]) => key);
  for (const above of /^\s*- /.test(line) ? [] : [...lines].reverse()) {
    const match = /^(\s*(?:- +)*)([\w]+):/.exec(above);
    const indent = /^(\s*)/.exec(above)?.[1].length ?? 0;
    if (above.trim() && indent < column && (!match || match[1].length < column)) break;
    if (match && match[1].length === column) {
      keys.push(match[2]);
      if (match[1].includes("-")) break;
    }
  }
  return keys;
}

/** What may stand there, references followed. @param {any} schema @param {(string | number)[]} path @returns {any[]} */
function at(schema, path) {
  let here = [schema];
  for (const part of path) {
    here = here.flatMap((one) => {
      const inner = typeof part === "number" ? one.items : one.properties?.[part] ?? one.additionalProperties;
      return inner && typeof inner === "object" ? follow(schema, inner) : [];
    });
  }
  return here;
}

/** @param {any} schema @param {any} of @returns {any[]} without null */
function follow(schema, of) {
  if (of.$ref) return follow(schema, schema.$defs[of.$ref.split("/").at(-1)]);
  const several = of.anyOf ?? of.oneOf;
  if (several) return several.flatMap((/** @type {any} */ one) => follow(schema, one));
  return of.type === "null" ? [] : [of];
}
