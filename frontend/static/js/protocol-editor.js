// @ts-check
/**
 * The editor of a draft: a timeline of stages with forms, the YAML beside it. The text is what counts: a form sends what it
 * changes with the text as it stands, and the server sends the text back with that line changed, its errors and its forms.
 */

import { plainText } from "./plain-text.js";

/**
 * @typedef {{ line: number, message: string }} Problem
 * @typedef {{ yaml: string, mark: string, refused: string | null, problems: Problem[], part: string | null }} Edited
 * @typedef {{ protocol: any, names: Record<string, string[]> }} Known what may be written
 * @typedef {{ text: string, show(problems: Problem[]): void, goTo(line: number): void }} TextEditor
 */

const CHECKED_AFTER_MS = 500;
const TRIED_AGAIN_MS = 3000;

const root = /** @type {HTMLElement} */ (document.getElementById("editor"));
const part = /** @type {HTMLElement} */ (document.getElementById("editor-part"));
const state = /** @type {HTMLElement} */ (document.getElementById("editor-state"));
const area = /** @type {HTMLTextAreaElement} */ (document.getElementById("yaml"));
const preview = /** @type {HTMLDialogElement} */ (document.getElementById("preview"));
const { here = "", csrf = "", moved = "", lost = "", kept = "" } = root.dataset;

let editor = plainText(area, () => check());
/** @type {Promise<unknown>} one after the other, each with the text that the one before it left */
let turn = Promise.resolve();
/** @type {Set<string>} which forms are open */
const open = new Set();
/** of the text that the server kept: another window's change has another */
let { mark = "" } = root.dataset;
let timer = 0;
let unsaved = false;

/** Once nobody has typed for a moment. */
function check() {
  unsaved = true;
  clearTimeout(timer);
  timer = window.setTimeout(() => send(null), CHECKED_AFTER_MS);
}

/**
 * Have the server make a change, or only look at the text.
 * @param {object | null} change
 * @param {() => void} [then] before the new forms are shown
 */
function send(change, then = () => {}) {
  clearTimeout(timer);
  turn = turn.then(() => ask(change, then));
  return turn;
}

/** @param {object | null} change @param {() => void} then */
async function ask(change, then) {
  for (;;) {
    const yaml = editor.text;
    const answer = await post({ seen: mark, yaml, change });
    if (answer && editor.text === yaml) {
      if (!answer.refused) then();
      show(answer);
      return;
    }
    if (answer && !change) return check(); // somebody types
    if (!answer) await new Promise((done) => setTimeout(done, TRIED_AGAIN_MS));
  }
}

/** @param {object} body @returns {Promise<Edited | null>} null: not now */
async function post(body) {
  try {
    const answer = await fetch(`${here}/edit`, {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-CSRF": csrf },
      body: JSON.stringify(body),
    });
    if (answer.ok) return await answer.json();
    if ([401, 403, 404].includes(answer.status)) location.reload(); // signed out, or the draft is gone
    else if (answer.status < 500 && answer.status !== 429) {
      const { error } = await answer.json();
      return { yaml: editor.text, mark, refused: error.message, problems: [], part: null };
    }
  } catch {
    // no connection
  }
  state.textContent = lost;
  return null;
}

/** @param {Edited} answer */
function show(answer) {
  unsaved = false;
  mark = answer.mark;
  editor.text = answer.yaml;
  editor.show(answer.problems);
  state.textContent = answer.refused ?? kept;
  state.classList.toggle("error", answer.refused !== null);
  part.inert = answer.part === null; // the text cannot be read: the forms are of before
  if (answer.part === null) return;
  const focused = document.activeElement instanceof HTMLElement && part.contains(document.activeElement) ? selectorOf(document.activeElement) : "";
  const name = /** @type {HTMLInputElement | null} */ (part.querySelector("#name"));
  const renamed = name && name.value !== name.defaultValue ? name.value : null;
  part.innerHTML = answer.part;
  reopen();
  const again = /** @type {HTMLInputElement | null} */ (part.querySelector("#name"));
  if (again && renamed !== null) again.value = renamed;
  if (focused) /** @type {HTMLElement | null} */ (part.querySelector(focused))?.focus();
}

function reopen() {
  for (const details of part.querySelectorAll("details[data-opened]")) {
    /** @type {HTMLDetailsElement} */ (details).open = open.has(/** @type {HTMLElement} */ (details).dataset.opened ?? "");
  }
}

/** How what has the focus is found again. @param {HTMLElement} element */
function selectorOf(element) {
  if (element.id) return `#${CSS.escape(element.id)}`;
  const { do: does, at, to, index } = element.dataset;
  const names = Object.entries({ do: does, at, to, index }).filter(([, value]) => value !== undefined);
  return names.map(([key, value]) => `[data-${key}=${CSS.escape(String(value))}]`).join("");
}

addEventListener("beforeunload", (event) => {
  if (unsaved) event.preventDefault();
});

// ---- what the forms send

part.addEventListener("change", (event) => {
  const input = /** @type {HTMLInputElement} */ (event.target);
  const field = /** @type {HTMLElement | null} */ (input.closest("[data-path]"));
  if (!field || !input.checkValidity()) return input.reportValidity?.();
  const path = JSON.parse(field.dataset.path ?? "[]");
  const value = valueOf(field, input);
  if (value === null && !("given" in field.dataset)) return;
  void send({ do: "set", path, value });
});

/** @param {HTMLElement} field @param {HTMLInputElement} input @returns {any} null: take it out */
function valueOf(field, input) {
  switch (field.dataset.type) {
    case "flag":
      return input.checked;
    case "number":
      return input.value === "" ? null : Number(input.value);
    case "several":
      return [...field.querySelectorAll("input")].filter((one) => one.checked).map((one) => one.value);
    case "words": {
      const words = input.value.split(",").map((word) => word.trim()).filter(Boolean);
      return words.length ? words : null;
    }
  }
  return input.value.trim() === "" ? null : input.value.trim();
}

part.addEventListener("click", (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  const shown = /** @type {HTMLAnchorElement | null} */ (target.closest("[data-preview]"));
  const line = /** @type {HTMLElement | null} */ (target.closest("a[data-line]"));
  if (shown || line) event.preventDefault();
  if (shown) look(shown.href);
  if (line) editor.goTo(Number(line.dataset.line));
  const button = /** @type {HTMLElement | null} */ (target.closest("button[data-do]"));
  if (!button) return;
  const { do: does, at = "[]", index = "0", to = "0", kind } = button.dataset;
  if (does === "move") return void move(Number(index), Number(to));
  const path = JSON.parse(at);
  if (does === "remove") {
    const staged = path.length === 2 && path[0] === "stages";
    return void send({ do: "remove", path }, () => staged && renumber((k) => (k > path[1] ? k - 1 : k === path[1] ? -1 : k)));
  }
  const chosen = kind ? /** @type {HTMLSelectElement} */ (document.getElementById(kind)).value : null;
  void send({ do: "insert", path, index: Number(index), kind: chosen }, () => {
    if (path.length > 1) return;
    for (const name of [...open]) if (name.startsWith("stage")) open.delete(name);
    open.add(`stage-${index}`);
  });
});

/** @param {number} index @param {number} to */
async function move(index, to) {
  await send({ do: "move", path: ["stages"], index, to }, () =>
    renumber((k) => (k === index ? to : index < k && k <= to ? k - 1 : to <= k && k < index ? k + 1 : k)),
  );
  const stage = part.querySelectorAll(".timeline > li")[to];
  const name = stage?.querySelector("summary span")?.textContent?.replace(/^\d+\. /, "") ?? "";
  state.textContent = moved.replace("{name}", name).replace("{number}", String(to + 1)).replace("{of}", String(stage?.parentElement?.children.length));
  if (!part.contains(document.activeElement)) /** @type {HTMLElement | null} */ (stage?.querySelector("summary"))?.focus();
}

/** Forms that are open stay with their stages. @param {(index: number) => number} at where a stage is now */
function renumber(at) {
  const before = [...open];
  open.clear();
  for (const name of before) open.add(name.replace(/^stages?-(\d+)/, (all, index) => all.replace(index, String(at(Number(index))))));
}

part.addEventListener("toggle", (event) => {
  const { opened = "", line } = /** @type {HTMLElement} */ (event.target).dataset;
  if (!(event.target instanceof HTMLDetailsElement) || !opened) return;
  if (event.target.open === open.has(opened)) return;
  if (event.target.open) open.add(opened);
  else open.delete(opened);
  if (event.target.open && line) editor.goTo(Number(line));
}, true);

// ---- dragging, by whatever pointer; by keyboard the buttons do it

part.addEventListener("pointerdown", (event) => {
  const handle = /** @type {HTMLElement} */ (event.target).closest(".handle");
  const dragged = handle?.closest("li");
  if (!(handle instanceof HTMLElement) || !dragged || event.button) return;
  event.preventDefault();
  handle.setPointerCapture(event.pointerId);
  const stages = /** @type {HTMLElement[]} */ ([...part.querySelectorAll(".timeline > li")]);
  const index = stages.indexOf(dragged);
  let to = index;
  dragged.classList.add("dragged");
  /** @param {PointerEvent} over */
  const follow = (over) => {
    const above = stages.filter((stage) => stage !== dragged && over.clientY > middle(stage)).length;
    to = above;
    stages.forEach((stage) => stage.classList.remove("above", "below"));
    if (to < index) stages[to].classList.add("above");
    if (to > index) stages[to].classList.add("below");
  };
  /** @param {PointerEvent} end */
  const drop = (end) => {
    handle.removeEventListener("pointermove", follow);
    stages.forEach((stage) => stage.classList.remove("above", "below", "dragged"));
    if (end.type === "pointerup" && to !== index) void move(index, to);
  };
  handle.addEventListener("pointermove", follow);
  handle.addEventListener("pointerup", drop, { once: true });
  handle.addEventListener("pointercancel", drop, { once: true });
});

/** @param {HTMLElement} stage */
function middle(stage) {
  const { top, height } = stage.getBoundingClientRect();
  return top + height / 2;
}

// ---- a step as participants see it, beside what it is made of

/** @param {string} address */
function look(address) {
  /** @type {HTMLIFrameElement} */ (preview.querySelector("iframe")).src = address;
  /** @type {HTMLAnchorElement} */ (preview.querySelector("a")).href = address;
  preview.showModal();
}

const frame = /** @type {HTMLIFrameElement} */ (preview.querySelector("iframe"));
preview.addEventListener("close", () => frame.removeAttribute("src"));
frame.addEventListener("load", () => {
  const at = frame.contentWindow?.location.pathname ?? "";
  if (preview.open && at.startsWith("/") && !at.includes("/preview/")) preview.close(); // behind the last step
});

// ---- the text: CodeMirror where it is installed, else the plain field

root.classList.add("live");
reopen();
try {
  const known = /** @type {Known} */ (await (await fetch(`${here}/schema.json`)).json());
  const { codeMirror } = await import("./code-mirror.js");
  editor = await codeMirror(area, known, () => check());
} catch (problem) {
  console.info("The plain text field is used.", problem);
}
void send(null);
