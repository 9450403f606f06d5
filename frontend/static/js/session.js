// @ts-check
/**
 * A running session: shows the step that the server says, sends what the participant does. The server owns the state;
 * whatever happens here, `refresh` shows again where the session stands.
 */

import { copyText, localTimes } from "./copy.js";
import { readyDialogs } from "./dialogs.js";
import { HeadPoses } from "./head-pose.js";
import { Headset } from "./headset.js";
import { keeper } from "./keep.js";
import { kindModule } from "./kind.js";
import { noticer } from "./notice.js";
import { pageData, speaker } from "./say.js";
import { Refused, ask, fetchText, newRequestId, watchConnection } from "./send.js";
import { StageFrame } from "./stage-frame.js";

/** @typedef {import("./types.js").PageData} PageData */
/** @typedef {import("./types.js").SessionState} SessionState */

const POLL_MS = 4000;
/** What the page shows instead of a step of the plan. */
const NO_STEP = ["paused", "withdrawn", "expired", "screened_out", "too_soon"];

const data = /** @type {PageData} */ (pageData());
const say = speaker(data.texts, data.language);
const api = `/api/session/${data.token}`;
const keep = keeper(data.token);
const notice = noticer(api);
const $ = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const step = $("step");
const banner = $("banner");

/** @type {SessionState} */
let current = data.state;
/** What is under the stage. @type {import("./kind.js").Bar | null} */
let trial = null;
/** Hears of the job, where something is waited for. @type {import("./kind.js").Mounted["job"] | null} */
let wait = null;
/** @type {EventSource | null} */
let stream = null;
/** Watches for the end of a long text. @type {IntersectionObserver | null} */
let ending = null;
let elsewhere = false;
/** Counts arrivals of steps, so that a slow page never overwrites a newer one. */
let arrival = 0;
/** Counts what was sent: a state asked for before that is old news. */
let sent = 0;
/** @type {Promise<void> | null} */
let refreshing = null;

const heads = new HeadPoses(`${api}/head`, () => (document.body.dataset.layout === "stage" ? current.step?.key : undefined));
const stage = new StageFrame($("stage-frame"), data.stage_origin, (message) => {
  heads.hear(message);
  headset.hear(message);
  hearSound(message);
  trial?.hear(message);
});
let sounds = data.motor_sound === "heard";

/** @param {import("./stage-frame.js").StageMessage} message */
function hearSound({ type, on = false }) {
  if (type === "sound") {
    sounds = on;
    notice("sound", { on });
  } else if (data.motor_sound !== "silent" && (type === "state" || type === "connected")) {
    stage.sound({ words: { on: say("sound.on"), off: say("sound.off") }, on: sounds });
  }
}

const headset = new Headset(data.headset, {
  say,
  tell: (order) => stage.headset(order),
  banner: showBanner,
  notice: (details) => notice("headset", details),
  headPose: data.head_pose,
  changed: () => {
    trial?.update(/** @type {any} */ (current.step?.trial ?? {}));
    if (document.body.dataset.layout !== "stage") closeStage();
  },
});

// ---- what the server says ------------------------------------------------------------------------------------------

/** @param {SessionState} state */
const identity = (state) => (state.state === "active" || state.state === "completed" ? state.step?.key : state.state);

/** @param {SessionState} state */
async function follow(state) {
  if (elsewhere) return;
  const moved = identity(state) !== identity(current);
  current = state;
  if (moved) await arrive();
  else if (state.step.trial) trial?.update(/** @type {any} its own kind of state */ (state.step.trial));
}

/** Asks the server where the session stands, and shows it. Calls that come meanwhile share the answer. */
function refresh() {
  refreshing ??= askState().finally(() => {
    refreshing = null;
  });
  return refreshing;
}

async function askState() {
  try {
    for (;;) {
      const before = sent;
      /** @type {SessionState} */
      const state = await ask(api);
      if (before === sent) return await follow(state);
    }
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    location.reload(); // the link no longer counts: the server's page says why
  }
}

/** Sends something that may change the session. @param {string} url @param {object} body @returns {Promise<any>} */
async function send(url, body) {
  sent += 1;
  try {
    return await ask(url, body);
  } finally {
    sent += 1;
  }
}

/** Fetches the current step and shows it. */
async function arrive() {
  const mine = ++arrival;
  const html = await fetchText(`/p/${data.token}/step`);
  if (mine !== arrival || elsewhere) return;
  const parsed = new DOMParser().parseFromString(html, "text/html");
  step.replaceChildren(...parsed.body.childNodes);
  const body = /** @type {HTMLElement | null} */ (step.querySelector(".step-body"));
  // The fragment may be newer than the state that made us fetch it.
  if (current.step && body?.dataset.key && body.dataset.key !== current.step.key) current = await ask(api);
  if (mine !== arrival || elsewhere) return;
  await mount(mine);
  if (mine !== arrival || elsewhere) return;
  scrollTo(0, 0);
  if (!trial) /** @type {HTMLElement | null} */ (step.querySelector("h1"))?.focus({ preventScroll: true });
}

/** Brings the step in `#step` to life; what its kind does is `kinds/KIND.js`'s. mine: the arrival that it belongs to. */
async function mount(mine = arrival) {
  announce(""); // what was said about the step before is no news about this one
  trial?.leave();
  trial = null;
  wait = null;
  const body = /** @type {HTMLElement | null} */ (step.querySelector(".step-body"));
  const kind = body?.dataset.kind ?? "";
  showProgress(body, false);
  for (const one of $("help-dialog").querySelectorAll("[data-help]")) {
    /** @type {HTMLElement} */ (one).hidden = /** @type {HTMLElement} */ (one).dataset.help !== (body?.dataset.helpsWith ?? "");
  }
  localTimes(step);
  notice("viewed", { step: body?.dataset.key, kind });

  const onStage = Boolean(step.querySelector(".trialbar")) && current.state === "active";
  document.body.dataset.layout = onStage ? "stage" : "text";
  $("stage").classList.toggle("aside", !onStage && headset.worn);
  $("stage").hidden = !onStage && !headset.worn;
  // Changing the language loads the page anew, which no pair may suffer.
  $("tools").querySelectorAll(".language").forEach((form) => ((/** @type {HTMLElement} */ (form)).hidden = onStage));
  // Before the step fills its place with something else; in a headset the room stands and says to take it off.
  if (!onStage && !headset.worn) closeStage();
  const link = /** @type {HTMLElement | null} */ (step.querySelector("[data-own-link]"));
  if (link) link.textContent = `${location.origin}${link.dataset.ownLink || `/p/${data.token}`}`;

  const module = current.step && !NO_STEP.includes(kind) ? await kindModule(kind) : null;
  if (mine !== arrival || elsewhere) return;
  if (module && current.step) {
    const key = current.step.key;
    headset.use(/** @type {any} */ (current.step.trial)?.worn ?? null);
    const mounted = module.mount({
      step,
      key,
      state: /** @type {any} its own kind of state */ (current.step.trial ?? { phase: "ready" }),
      language: data.language,
      say,
      answer: (value) => answer(key, kind, value),
      keep: (values) => keep.draft(key, values),
      kept: keep.drafted(key),
      page: { refresh, announce, cover, headset, reloadStage: () => stage.reload(), greetStage: () => stage.greet(), moveOut, notice },
      poster: (room) => (path, body) => send(`${api}/${room}/${encodeURIComponent(key)}/${path}`, body),
      tell: (order) => stage.draw(order),
      toStage: () => stage.focus(),
    });
    trial = mounted?.bar ?? null;
    wait = mounted?.job ?? null;
    if (onStage && !current.stage_url) {
      stage.close();
      headset.hear({ type: "headset", on: false }); // whose frame is gone, and says so no more
    } else if (onStage) stage.open(current.stage_url ?? "", step.querySelector("h1")?.textContent ?? "");
    if (module.last) showProgress(body, true);
  }
  if (body) body.dataset.live = "";
  tellMore(Boolean(module?.longText));
}

function closeStage() {
  stage.close();
  $("stage").hidden = true;
}

/** Long texts: the bar says that there is more below, until the end has come into sight. @param {boolean} long */
function tellMore(long) {
  ending?.disconnect();
  const next = step.querySelector(".bottombar > .next");
  let end = step.querySelector(".content")?.lastElementChild;
  while (end?.lastElementChild && end.matches(".prose, ul, ol, fieldset")) end = end.lastElementChild;
  if (!next || !end || !long) return;
  const words = next.textContent;
  const bar = /** @type {HTMLElement} */ (next.parentElement).offsetHeight;
  ending = new IntersectionObserver(
    ([seen]) => {
      next.textContent = seen.isIntersecting ? words : say("more");
      if (seen.isIntersecting) ending?.disconnect();
    },
    { rootMargin: `0px 0px ${-bar}px 0px`, threshold: 0.9 },
  );
  ending.observe(end);
}

/** @param {HTMLElement | null} body of the step, which says how far it is @param {boolean} last */
function showProgress(body, last) {
  const going = ["active", "completed"].includes(current.state);
  $("progress").hidden = !going;
  $("tools").querySelectorAll("[data-pause], [data-opens=leave-dialog]").forEach((button) => {
    /** @type {HTMLElement} */ (button).hidden = current.state !== "active" || last;
  });
  for (const one of /** @type {NodeListOf<HTMLElement>} */ ($("progress-text").querySelectorAll("[data-says]"))) {
    one.textContent = body?.dataset[one.dataset.says ?? ""] ?? "";
  }
  /** @type {HTMLProgressElement} */ ($("progress").querySelector("progress")).value = Number(body?.dataset.behind ?? 0);
}

/** The stream tells at once; the poll tells if the stream cannot. */
function listen() {
  stream?.close();
  stream = new EventSource(`${api}/stream`);
  stream.addEventListener("state", () => refresh());
  stream.addEventListener("moved", (event) => {
    /** @type {Partial<import("./contract.js").Moved>} */
    const moved = parse(event);
    if (moved.reason === "step") refresh();
    else moveOut();
  });
  stream.addEventListener("job", (event) => {
    /** @type {import("./contract.js").JobNews} */
    const job = parse(event);
    wait?.(job);
    if (job.done) refresh();
  });
}

/** @param {Event} event @returns {any} */
function parse(event) {
  try {
    return JSON.parse(/** @type {MessageEvent} */ (event).data || "{}");
  } catch {
    return {};
  }
}

// ---- what the participant does -------------------------------------------------------------------------------------

/**
 * Sends an answer until it is acknowledged, then shows what follows. What may be answered there, the kind's module knows.
 * @param {string} key @param {string} kind @param {object} value
 */
async function answer(key, kind, value) {
  const url = `${api}/steps/${encodeURIComponent(key)}`;
  const sent = { request_id: newRequestId(), kind, value, client_time: new Date().toISOString() };
  const body = /** @type {import("./contract.js").AnswerSent} */ (sent);
  keep.hold({ url, body });
  if (await deliver(url, body)) keep.forget(key);
}

/** @param {string} url @param {object} body @returns {Promise<boolean>} whether it was accepted */
async function deliver(url, body) {
  try {
    /** @type {import("./contract.js").Answered} */
    const answered = await send(url, body);
    keep.release();
    await follow(answered);
    return true;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    keep.release();
    showBanner(say("refused"), 6000);
    await refresh();
    return false;
  }
}

async function pauseSession() {
  for (const dialog of document.querySelectorAll("dialog")) dialog.close();
  await send(`${api}/pause`, { request_id: newRequestId() }).catch(ignoreRefusal);
  await refresh();
}

async function withdraw() {
  try {
    await send(`${api}/withdraw`, { request_id: newRequestId() });
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    $("leave-result").textContent = say("refused");
    return;
  }
  for (const dialog of document.querySelectorAll("dialog")) dialog.close();
  await refresh();
}

/** @param {unknown} error */
function ignoreRefusal(error) {
  if (!(error instanceof Refused)) throw error; // a refusal is answered by showing where the session stands
}

document.addEventListener("click", async (event) => {
  const button = event.target instanceof Element ? event.target.closest("button") : null;
  if (!button || button.getAttribute("aria-disabled") === "true") return;
  if ("pause" in button.dataset) await once(button, pauseSession);
  else if ("withdraw" in button.dataset) await once(button, withdraw);
  else if ("resume" in button.dataset) {
    await once(button, async () => {
      await send(`${api}/resume`, { request_id: newRequestId() }).catch(ignoreRefusal);
      await refresh();
    });
  } else if ("reload" in button.dataset) location.reload();
  else if (button.dataset.copy) {
    const copied = await copyText($(button.dataset.copy));
    const result = button.parentElement?.querySelector("[data-copied]");
    if (result) result.textContent = say(copied ? "copied" : "copy_failed");
  }
});

/** A second press while the first is under way does nothing. @param {HTMLButtonElement} button @param {() => Promise<void>} action */
async function once(button, action) {
  button.setAttribute("aria-disabled", "true");
  try {
    await action();
  } finally {
    button.removeAttribute("aria-disabled");
  }
}

$("problem-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const field = /** @type {HTMLTextAreaElement} */ ($("problem-text"));
  const text = field.value.trim();
  if (!text) {
    field.focus();
    return;
  }
  try {
    /** @type {import("./contract.js").ProblemReport} */
    const report = { text };
    await ask(`${api}/problem`, report);
    field.value = "";
    $("problem-result").textContent = say("problem_sent");
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    $("problem-result").textContent = say("problem_failed");
  }
});

// ---- words around the step -----------------------------------------------------------------------------------------

/** @param {string} text */
function announce(text) {
  $("live").textContent = text;
}

/** @param {string | null} text */
function cover(text) {
  $("stage-cover").hidden = text === null;
  if (text !== null) {
    $("stage-cover-text").textContent = text;
    announce(text);
  }
}

/** @type {ReturnType<typeof setTimeout> | undefined} */
let bannerEnd;

/** @param {string | null} text @param {number} [forMs] */
function showBanner(text, forMs) {
  clearTimeout(bannerEnd);
  banner.hidden = text === null;
  banner.textContent = text ?? "";
  if (forMs) bannerEnd = setTimeout(() => showBanner(null), forMs);
}

/** Another window has taken over: this one rests, and offers to take over again. */
function moveOut() {
  elsewhere = true;
  announce("");
  trial?.leave();
  trial = null;
  stream?.close();
  stage.close();
  $("stage").hidden = true;
  $("progress").hidden = true;
  $("tools").hidden = true;
  document.body.dataset.layout = "text";
  const words = /** @type {HTMLTemplateElement} */ (document.getElementById("elsewhere"));
  step.replaceChildren(words.content.cloneNode(true));
  /** @type {HTMLElement | null} */ (step.querySelector("h1"))?.focus();
}

// ---- begin ---------------------------------------------------------------------------------------------------------

watchConnection((waiting) => {
  const offline = keep.held() ? "offline_answer" : "offline";
  showBanner(waiting ? say({ server: "busy", full: "full", connection: offline }[waiting]) : null);
  if (!waiting) notice("connection", { back: true });
});
document.addEventListener("visibilitychange", () => notice("visibility", { hidden: document.hidden }));
addEventListener("error", (event) => notice("script_error", { message: String(event.message).slice(0, 300) }));
addEventListener("unhandledrejection", (event) => notice("script_error", { message: String(event.reason).slice(0, 300) }));
readyDialogs();
void mount();
listen();
addEventListener("pageshow", (event) => {
  if (event.persisted) location.reload(); // back from the browser's memory: what it shows may be long past
});
setInterval(() => {
  const quiet = stream?.readyState !== EventSource.OPEN;
  if (!elsewhere && !document.hidden && current.state === "active" && (quiet || wait)) refresh();
}, POLL_MS);
const held = keep.held();
if (held) deliver(held.url, held.body);
