// @ts-check
/** Rules that last: told in sentences, each a card with a picture of where it applies; changed, ordered, switched off. */

import { floorPicture, onFloor } from "../floor-picture.js";
import { stageNeeds } from "../kind.js";
import { LivePanel } from "../live.js";
import { Refused } from "../send.js";

/** @typedef {import("../contract.js").RulesReply} RulesReply */
/** @typedef {import("../contract.js").RuleShown} RuleShown */
/** @typedef {import("../contract.js").RuleAsked} RuleAsked */
/** @typedef {Required<import("../contract.js").Rule>} Rule */
/** @typedef {{rule: number, place: number, side: "a" | "b" | null}} Picked */
/**
 * @typedef {object} Card
 * @property {Rule} rule
 * @property {RuleAsked[]} asked what is still open
 * @property {{place: number, floor: RulesReply["floor"], a: number[][], b: number[][]} | null} [pair] obeyed and broken, in an order by lot
 * @property {boolean} [seen] whether such a pair was looked for
 * @property {"a" | "b" | "neither" | null} [picked]
 */

const SMALLEST_M = 0.3;
const STEP_M = 0.1; // of a key
const FIRST_M = 1.2; // side of a zone before it is drawn

/** Tracks as points on the floor. @param {number[][]} track */
const points = (track) => track.map(([, x, y]) => [x, y]);

class Telling extends LivePanel {
  /** @param {HTMLElement} root @param {ConstructorParameters<typeof LivePanel>[1]} needs */
  constructor(root, needs) {
    super(root, needs);
    this.names = JSON.parse(document.getElementById("weight-words")?.textContent ?? "{}");
    this.field = /** @type {HTMLTextAreaElement} */ (root.querySelector("#rules-sentence"));
    /** @type {Card[]} */
    this.cards = /** @type {any} */ (needs.kept?.cards) ?? [];
    /** @type {object[]} */
    this.history = /** @type {any} */ (needs.kept?.changes) ?? [];
    /** Pairs of rules whose order was confirmed. @type {string[]} */
    this.ordered = /** @type {any} */ (needs.kept?.ordered) ?? [];
    /** @type {RulesReply | null} */
    this.reply = null;
    /** The card whose sentence is in the field; cards stay the same objects while they are moved. @type {Card | null} */
    this.editing = null;
    this.reading = false;
    this.opened = performance.now();
    this.field.addEventListener("input", () => this.show());
    this.show();
  }

  note() {
    this.keep({ cards: this.cards, changes: this.history, ordered: this.ordered, place: this.place });
  }

  get rules() {
    return this.cards.map((card) => card.rule);
  }

  /** Strokes and key presses in a row that draw one rule's zone are one change. @param {{do: string, rule: number, [more: string]: unknown}} change */
  did(change) {
    const last = /** @type {typeof change | undefined} */ (this.history.at(-1));
    if (change.do === "drawn" && last?.do === "drawn" && last.rule === change.rule) this.history.pop();
    const done = { seconds: (performance.now() - this.opened) / 1000, ...change };
    if (this.history.length < Number(this.root.dataset.mostChanges)) this.history.push(done);
    this.note();
    this.want();
  }

  // ---- the way -------------------------------------------------------------------------------------------------------

  async askOnce() {
    if (!this.cards) return; // the panel's own constructor is at work
    const { place } = this;
    this.driving = false;
    const request = (this.requests += 1);
    try {
      const rules = this.cards.map(({ rule, asked }) => (asked.length ? { ...rule, on: false } : rule)); // nothing holds that is still asked back
      /** @type {RulesReply} */
      const reply = await this.needs.post("rules", { rules, place });
      if (this.over || place !== this.place || request < this.newest) return;
      this.newest = request;
      this.reply = reply;
      if (this.blind) this.rest();
      else this.draw({ place, why: [], paths: [reply.path] }, false, null);
      this.list();
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      await this.needs.refresh();
    }
  }

  /** Whether a pair is open: what else is drawn must not tell which of the two keeps the rule. */
  get blind() {
    return this.cards.some((card) => this.isOpen(card));
  }

  /** @param {Card} card */
  isOpen({ pair, picked }) {
    return Boolean(pair) && !picked;
  }

  /** No way is drawn on the stage, and none is driven. */
  rest() {
    this.driving = false;
    this.paths = null;
    this.orders += 1;
    /** @type {import("../contract.js").PathsMessage} */
    const order = { do: "paths", id: String(this.orders), onward: false, since: null, paths: [], legend: [] };
    this.tell({ type: "steer", ...order });
    this.text("#live-way", this.own("rules.choose_first"));
    this.root.querySelector("#live-way")?.removeAttribute("data-attention");
    this.show();
  }

  show() {
    super.show();
    if (!this.field) return;
    const full = this.editing === null && this.cards.length >= Number(this.root.dataset.most);
    const may = this.field.value.trim() && !this.reading && !full;
    this.root.querySelector("[data-tell]")?.setAttribute("aria-disabled", String(!may));
    this.text("[data-tell]", this.own(this.editing === null ? "rules.tell" : "rules.change_it"));
  }

  /** What is still to be done before the answer can be given; null: nothing. @returns {string | null} */
  get missing() {
    if (!this.cards || this.cards.length < Number(this.root.dataset.least)) return "rules.tell_first";
    if (this.cards.some((card) => !this.isComplete(card))) return "rules.answer_first";
    if (this.clashes.length) return "rules.order_first";
    if (this.cards.some((card) => !card.seen || (card.pair && !card.picked))) return "rules.look_first";
    return null;
  }

  get mayDecide() {
    return Boolean(this.paths) && this.missing === null;
  }

  /** @param {Card} card */
  isComplete({ rule, asked }) {
    const drawn = rule.zones.every((zone) => zone.kind !== "here" || zone.drawn);
    return asked.length === 0 && drawn && rule.wishes.length + rule.zones.length > 0;
  }

  /** Collisions whose order nobody has confirmed. */
  get clashes() {
    return (this.reply?.collisions ?? []).filter(({ first, second }) => !this.ordered.includes(this.pairKey(first, second)));
  }

  /** @param {number} first @param {number} second */
  pairKey(first, second) {
    return JSON.stringify([first, second].map((number) => this.cards[number]?.rule.words));
  }

  // ---- telling -------------------------------------------------------------------------------------------------------

  async tell1() {
    const sentence = this.field.value.trim();
    const old = this.editing;
    this.reading = true;
    this.show();
    try {
      /** @type {RulesReply} */
      const { read } = await this.needs.post("rules", { rules: [], place: this.place, sentence });
      if (this.over || !read) return;
      const card = { rule: /** @type {Rule} */ (read.rule), asked: read.asked.filter((one) => one.about !== "place") };
      const place = old ? this.cards.indexOf(old) : -1; // it may have been moved or removed meanwhile
      const at = place < 0 ? this.cards.length : place;
      this.cards.splice(at, 1, card);
      if (this.editing === old) this.editing = null;
      this.field.value = "";
      this.did({ do: place < 0 ? "told" : "edited", rule: at, words: sentence });
      this.list();
      this.needs.announce(this.read(card));
      this.root.querySelector(`[data-card="${at}"]`)?.scrollIntoView({ block: "nearest" });
    } finally {
      this.reading = false;
      if (!this.over) this.show();
    }
  }

  /** A rule was changed by its card. @param {Card} card @param {Partial<Rule>} to @param {{do: string}} change */
  put(card, to, change) {
    const same = "on" in to;
    Object.assign(card, { rule: { ...card.rule, ...to } }, same ? {} : { pair: null, seen: false, picked: null });
    this.did({ rule: this.cards.indexOf(card), ...change });
    this.list();
    this.show();
  }

  /** @param {number} at @param {number} to */
  move(at, to) {
    if (to < 0 || to >= this.cards.length) return;
    const [card] = this.cards.splice(at, 1);
    this.cards.splice(to, 0, card);
    this.did({ do: "moved", rule: at, to });
    this.list();
    this.show();
  }

  // ---- the cards -----------------------------------------------------------------------------------------------------

  list() {
    const active = document.activeElement;
    const focused = active instanceof HTMLElement || active instanceof SVGElement ? active.dataset.does : undefined;
    const list = /** @type {HTMLElement} */ (this.root.querySelector("#rules-list"));
    list.replaceChildren(...this.cards.map((card, at) => this.card(card, at)));
    this.root.querySelector("#rules-clashes")?.replaceChildren(...this.clashes.map((clash) => this.clash(clash)));
    if (focused) /** @type {HTMLElement | null} */ (list.querySelector(`[data-does="${focused}"]`))?.focus();
    this.show();
  }

  /** @param {string} key @param {string} id @param {() => void} act @param {boolean} [off] */
  button(key, id, act, off = false) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.does = id;
    button.textContent = this.own(key);
    button.setAttribute("aria-disabled", String(off));
    button.addEventListener("click", () => !off && !this.busy && act());
    return button;
  }

  /** @param {string} css @param {string} text */
  paragraph(css, text) {
    const line = document.createElement("p");
    line.className = css;
    line.textContent = text;
    return line;
  }

  /** @param {Card} card @param {number} at */
  card(card, at) {
    const { rule } = card;
    const item = document.createElement("li");
    item.dataset.card = String(at);
    item.toggleAttribute("data-off", !rule.on);
    item.append(this.paragraph("rule-words", this.own("quoted", { words: rule.words })));
    item.append(this.paragraph("rule-when", this.own("rules.when_line", { when: this.when(rule) })));
    item.append(this.paragraph("rule-then", this.own("rules.then_line", { then: this.then(rule) })));
    const shown = this.reply?.shown[at];
    if (this.reply && shown) item.append(this.picture(card, at, this.reply, shown));
    for (const label of shown?.unavailable ?? []) item.append(this.paragraph("rule-note", this.own("rules.unavailable", { what: this.label(label) })));
    for (const asked of card.asked) item.append(this.question(asked, card, at));
    const last = this.cards.length - 1;
    const actions = document.createElement("div");
    actions.className = "rule-actions";
    actions.append(
      this.button("rules.edit", `edit-${at}`, () => this.edit(card)),
      this.button("rules.up", `up-${at}`, () => this.move(at, at - 1), at === 0),
      this.button("rules.down", `down-${at}`, () => this.move(at, at + 1), at === last),
      this.button(rule.on ? "rules.off" : "rules.on", `on-${at}`, () => this.put(card, { on: !rule.on }, { do: rule.on ? "off" : "on" })),
      this.button("rules.remove", `remove-${at}`, () => this.remove(card)),
    );
    item.append(actions);
    if (this.isComplete(card)) item.append(this.looked(card, at));
    return item;
  }

  /** @param {Card} card */
  edit(card) {
    this.editing = card;
    this.field.value = card.rule.words;
    this.field.focus();
    this.show();
  }

  /** @param {Card} card */
  remove(card) {
    const at = this.cards.indexOf(card);
    this.cards.splice(at, 1);
    if (this.editing === card) this.editing = null;
    this.did({ do: "revoked", rule: at });
    this.list();
  }

  /** @param {string} label of a condition, as `not:room:kitchen` */
  label(label) {
    const parts = label.split(":");
    const denied = parts[0] === "not";
    const [kind, of] = denied ? parts.slice(1) : parts;
    const said = kind === "room" ? this.own(`rules.room.${of}`) : of ? this.own(`rules.${kind}`, { what: this.own(`rules.things.${of}`) }) : this.own(`rules.conditions.${kind}`);
    return denied ? this.own("rules.not", { what: said }) : said;
  }

  /** @param {Rule} rule */
  when(rule) {
    const said = rule.when.map(({ kind, of, holds }) => this.label(`${holds === false ? "not:" : ""}${kind}${of ? `:${of}` : ""}`));
    return said.length ? said.join(" + ") : this.own("rules.always");
  }

  /** What a sentence was read as, and what is asked back. @param {Card} card */
  read({ rule, asked }) {
    const lines = [this.own("rules.when_line", { when: this.when(rule) }), this.own("rules.then_line", { then: this.then(rule) })];
    return [...lines, ...asked.map(({ about, text }) => this.own(`rules.asked.${about}`, { words: text }))].join(". ");
  }

  /** @param {Rule["wishes"][number]} wish */
  wish({ objective, more }) {
    if (more !== false) return this.names[objective].name;
    return objective === "faster" ? this.own("rules.slower") : this.own("rules.less", { what: this.names[objective].name });
  }

  /** @param {Rule} rule */
  then(rule) {
    const wishes = rule.wishes.map((wish) => this.wish(wish));
    const zones = rule.zones.map(({ kind, of }) =>
      this.own(`rules.zones.${kind}`, { what: of ? this.own(`rules.${kind === "room" ? "into" : "things"}.${of}`) : "" }),
    );
    return [...wishes, ...zones].join("; ") || this.own("rules.nothing_yet");
  }

  /** @param {Card} card @param {number} at @param {RulesReply} reply @param {RuleShown} shown */
  picture(card, at, reply, shown) {
    const label = this.own("rules.picture", { then: this.then(card.rule) });
    const zone = card.rule.zones.findIndex(({ kind }) => kind === "here");
    const zones = this.isOpen(card) && zone < 0 ? [] : shown.zones; // who drew one knows where it is
    const svg = floorPicture(reply.floor, { zones, holds: shown.holds_in, path: this.blind ? [] : points(reply.path.track), label });
    if (zone < 0) return svg;
    const last = card.rule.zones[zone].drawn ?? null;
    const drawn = last?.place === this.place ? last : null;
    const box = document.createElement("div");
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("role", "application");
    svg.dataset.does = `zone-${at}`;
    svg.classList.add("drawable");
    /** @param {number} x @param {number} y @param {number} length @param {number} width */
    const set = (x, y, length, width) => {
      const zones = card.rule.zones.map((one, k) => (k === zone ? { ...one, drawn: { x, y, yaw: 0, length, width, place: this.place } } : one));
      this.put(card, { zones }, { do: "drawn" });
    };
    /** @type {[number, number] | null} */
    let from = null;
    svg.addEventListener("pointerdown", (event) => {
      from = onFloor(svg, event);
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointerup", (event) => {
      const to = onFloor(svg, event);
      if (!from) return;
      const [length, width] = [Math.abs(to[0] - from[0]), Math.abs(to[1] - from[1])];
      if (Math.min(length, width) >= SMALLEST_M) set((from[0] + to[0]) / 2, (from[1] + to[1]) / 2, length, width);
      from = null;
    });
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!step) return;
      event.preventDefault();
      const now = drawn ?? { x: (reply.floor.start[0] + reply.floor.goal[0]) / 2, y: (reply.floor.start[1] + reply.floor.goal[1]) / 2, length: FIRST_M, width: FIRST_M };
      set(now.x + STEP_M * step[0], now.y + STEP_M * step[1], now.length, now.width);
    });
    box.append(svg, this.paragraph("rule-note", this.own(drawn ? "rules.draw_again" : "rules.draw")));
    if (last && !drawn) box.append(this.paragraph("rule-note", this.own("rules.drawn_elsewhere", { number: (last.place ?? 0) + 1 })));
    return box;
  }

  /** @param {RuleAsked} asked @param {Card} card @param {number} at */
  question(asked, card, at) {
    const box = document.createElement("div");
    box.className = "words-question";
    box.append(this.paragraph("rule-note", this.own(`rules.asked.${asked.about}`, { words: asked.text })));
    const { rule } = card;
    /** @param {Partial<Rule>} to */
    const settle = (to) => {
      card.asked = card.asked.filter((one) => one !== asked);
      this.put(card, to, { do: "answered" });
    };
    const directions = asked.offered.length === 1 ? [true, false] : [true]; // of one alone it is not clear which way
    const full = rule.wishes.length >= Number(this.root.dataset.mostWishes);
    for (const wish of full ? [] : asked.offered.flatMap((objective) => directions.map((more) => ({ objective, more })))) {
      const id = `meant-${at}-${wish.objective}${wish.more ? "" : "-less"}`;
      const button = this.button("rules.none", id, () => settle({ wishes: [...rule.wishes, wish] }));
      button.textContent = this.wish(wish);
      box.append(button);
    }
    if (asked.offered.length) {
      const left = rule.wishes.length + rule.zones.length > 0 || card.asked.length > 1;
      box.append(this.button("rules.none", `none-${at}`, () => (left ? settle({}) : this.edit(card)))); // who means nothing of it says it anew
    }
    if (asked.about === "context") box.append(this.button("rules.always_then", `always-${at}`, () => settle({})));
    box.append(this.button("rules.edit", `reword-${at}`, () => this.edit(card)));
    return box;
  }

  /** @param {RulesReply["collisions"][number]} clash */
  clash({ first, second }) {
    const box = document.createElement("div");
    box.className = "words-question";
    const [a, b] = [first, second].map((number) => this.cards[number]?.rule.words ?? "");
    box.append(this.paragraph("rule-note", this.own("rules.clash", { first: a, second: b })));
    for (const [number, words] of /** @type {[number, string][]} */ ([[first, a], [second, b]])) {
      const button = this.button("rules.none", `first-${number}`, () => {
        if (number === second) this.move(second, first);
        this.ordered.push(JSON.stringify(number === second ? [b, a] : [a, b]));
        this.note();
        this.list();
      });
      button.textContent = this.own("rules.first", { words });
      box.append(button);
    }
    return box;
  }

  // ---- obeyed and broken ---------------------------------------------------------------------------------------------

  /** Both pictures without zones, and the first choice stands: afterwards the way that keeps the rule is drawn. @param {Card} card @param {number} at */
  looked(card, at) {
    const box = document.createElement("div");
    box.className = "rule-pair";
    if (!card.seen) {
      box.append(this.button("rules.look", `look-${at}`, () => void this.look(card)));
      return box;
    }
    const { pair } = card;
    if (!pair) {
      box.append(this.paragraph("rule-note", this.own("rules.no_difference")));
      return box;
    }
    box.append(this.paragraph("rule-note", this.own("rules.which")));
    /** @param {"a" | "b" | "neither"} side */
    const choice = (side) => {
      const button = this.button("rules.neither", `pick-${side}-${at}`, () => this.pick(card, side), Boolean(card.picked));
      button.setAttribute("aria-pressed", String(card.picked === side));
      box.append(button);
      return button;
    };
    for (const side of /** @type {const} */ (["a", "b"])) {
      const label = this.own("rules.picture_of", { letter: side.toUpperCase() });
      choice(side).replaceChildren(floorPicture(pair.floor, { path: pair[side], label, near: true }), side.toUpperCase());
    }
    choice("neither");
    return box;
  }

  /** Finds a place in which the rule makes a difference. @param {Card} card */
  async look(card) {
    const { rule } = card;
    const order = Array.from({ length: this.places }, (_, k) => (this.place + k) % this.places);
    for (const place of order) {
      /** @type {RulesReply} */
      const { pair, floor } = await this.needs.post("rules", { rules: this.rules, place, check: this.cards.indexOf(card) });
      if (this.over || !this.cards.includes(card) || card.rule !== rule) return;
      if (pair) {
        card.pair = { place, floor, a: points(pair[0].track), b: points(pair[1].track) };
        break;
      }
    }
    card.seen = true;
    if (card.pair) this.rest();
    this.note();
    this.list();
    this.needs.announce(this.own(card.pair ? "rules.which" : "rules.no_difference"));
  }

  /** @param {Card} card @param {"a" | "b" | "neither"} side */
  pick(card, side) {
    card.picked = side;
    this.note();
    this.list();
    this.want(); // its way may be drawn now
  }

  // ---- the panel -----------------------------------------------------------------------------------------------------

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    const resting = button?.getAttribute("aria-disabled") === "true";
    if (button && "tell" in button.dataset) {
      if (!resting) void this.tell1();
    } else if (button && "done" in button.dataset && resting && this.missing) {
      const said = this.own(this.missing, { told: this.cards.length, least: Number(this.root.dataset.least) });
      this.needs.announce(said);
      this.text("#live-way", said);
    } else super.clicked(event);
  }

  async done() {
    /** @type {Picked[]} */
    const picked = this.cards.flatMap(({ pair, picked: side }, rule) => (pair && side ? [{ rule, place: pair.place, side: side === "neither" ? null : side }] : []));
    /** @type {import("../types.js").AnswerTo<"rules">} */
    const value = /** @type {any} */ ({ rules: this.rules, history: this.history, picked });
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"rules">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept } = page;
  return { bar: new Telling(panel, { ...stageNeeds(page, "live"), tell, language, keep, kept }) };
}
