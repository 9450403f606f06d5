// @ts-check
/** A wish in plain words: read by the server, shown with what was understood of it, then corrected by the sliders. */

import { stageNeeds } from "../kind.js";
import { LivePanel } from "../live.js";

/** @typedef {import("../contract.js").WordsUnderstood} WordsUnderstood */
/** @typedef {{question: number, objective: string | null}} Meant */

/** @type {Record<string, string>} */
const MEANINGS = { wanted: "matters", unwanted: "not_wanted", lesser: "matters_less" };
const ASKED = { unclear: "asked", contradiction: "contradicts", slowness: "only_slow_near" };

class Wording extends LivePanel {
  /** @param {HTMLElement} root @param {ConstructorParameters<typeof LivePanel>[1]} needs */
  constructor(root, needs) {
    super(root, needs);
    this.names = JSON.parse(document.getElementById("weight-words")?.textContent ?? "{}");
    this.field = /** @type {HTMLTextAreaElement} */ (root.querySelector("#words-sentence"));
    /** What was read, and of which sentence. @type {{sentence: string, got: WordsUnderstood} | null} */
    this.read = /** @type {any} */ (needs.kept?.read) ?? null;
    /** @type {Meant[]} */
    this.meant = /** @type {any} */ (needs.kept?.meant) ?? [];
    this.reading = false;
    this.field.value = String(needs.kept?.typed ?? "");
    this.field.addEventListener("input", () => {
      this.note();
      this.show();
    });
    if (this.read) this.tellRead();
    this.show();
  }

  note() {
    const { weights, history } = this.controls;
    this.keep({ weights, history, place: this.place, typed: this.field?.value ?? "", read: this.read, meant: this.meant });
  }

  /** The sentence as it stands was read. */
  get isRead() {
    return this.read !== null && this.read.sentence === this.field.value;
  }

  get isAnswered() {
    return this.read !== null && this.meant.length === this.read.got.questions.length;
  }

  show() {
    super.show();
    if (!this.field) return; // the panel's own constructor is at work
    /** @type {HTMLElement} */ (this.root.querySelector("#words-found")).hidden = !this.read;
    this.root.querySelector("[data-read]")?.setAttribute("aria-disabled", String(this.reading || this.isRead || !this.field.value.trim()));
  }

  get mayDecide() {
    return Boolean(this.field) && this.isRead && this.isAnswered;
  }

  /** How the way is; while a question is open, also why the answer cannot be given yet. */
  tellWay() {
    super.tellWay();
    if (!this.paths || !this.isRead || this.isAnswered) return;
    const way = this.root.querySelector("#live-way")?.textContent ?? "";
    this.text("#live-way", `${way} ${this.own("question_open")}`);
  }

  async readIt() {
    const sentence = this.field.value;
    this.reading = true;
    this.show();
    try {
      /** @type {WordsUnderstood} */
      const got = await this.needs.post("words", { sentence });
      if (this.over) return;
      this.read = { sentence, got };
      this.meant = [];
      this.controls.put(got.weights, "words");
      this.tellRead();
      this.tellWay();
      this.note();
    } finally {
      this.reading = false;
      if (!this.over) {
        this.show();
        this.root.querySelector("#words-found-title")?.scrollIntoView({ block: "start" });
      }
    }
  }

  /** What was read, in the sentence itself, each stretch with its meaning in words. */
  tellRead() {
    if (!this.read) return;
    const { parts, questions, weights, language } = this.read.got;
    const shown = /** @type {HTMLElement} */ (this.root.querySelector("#words-marked"));
    shown.replaceChildren(...parts.map((part) => this.stretch(part)));
    const missed = parts.filter((part) => part.as === "missed").map((part) => this.own("quoted", { words: part.text })).join(", ");
    const read = parts.some((part) => part.as !== "plain" && part.as !== "missed");
    const nothing = Object.keys(weights).length === 0 && !read;
    const unwanted = parts.some((part) => part.as === "unwanted" && part.objective !== "faster");
    const line = /** @type {HTMLElement} */ (this.root.querySelector("#words-missed"));
    const told = [
      language && this.own(language === "de" ? "read_as_german" : "read_as_english"),
      missed && this.own("missed", { words: missed }),
      unwanted && this.own("only_more"),
      nothing && this.own("nothing_understood"),
    ].filter(Boolean);
    line.hidden = told.length === 0;
    line.textContent = told.join(" ");
    this.root.querySelector("#words-questions")?.replaceChildren(...questions.map((one, number) => this.question(one, number)));
  }

  /** @param {WordsUnderstood["parts"][number]} part @returns {Node} */
  stretch(part) {
    if (part.as === "plain") return document.createTextNode(part.text);
    const mark = document.createElement("mark");
    mark.dataset.as = part.as;
    mark.append(part.text);
    const meaning = document.createElement("span");
    meaning.className = "words-meaning";
    meaning.textContent = this.meaning(part);
    mark.append(meaning);
    return mark;
  }

  /** @param {WordsUnderstood["parts"][number]} part @returns {string} */
  meaning(part) {
    if (part.as === "asked") return this.own("was_asked");
    if (part.as === "missed") return this.own("was_missed");
    const objective = this.names[part.objective ?? ""]?.name ?? "";
    return this.own(MEANINGS[part.as] ?? "matters", { objective });
  }

  /** @param {WordsUnderstood["questions"][number]} asked @param {number} number @returns {HTMLElement} */
  question({ text, offered, about }, number) {
    const set = document.createElement("fieldset");
    set.className = "words-question";
    const legend = document.createElement("legend");
    legend.textContent = this.own(ASKED[about], { words: text });
    set.append(legend);
    for (const objective of [...offered, null]) {
      const label = document.createElement("label");
      const choice = document.createElement("input");
      choice.type = "radio";
      choice.name = `meant-${number}`;
      choice.dataset.meant = objective ?? "none";
      choice.checked = this.meant.some((one) => one.question === number && one.objective === objective);
      choice.addEventListener("change", () => this.means(number, objective));
      label.append(choice, objective ? this.names[objective].name : this.own(about === "slowness" ? "not_slow_there" : "none_of_these"));
      set.append(label);
    }
    return set;
  }

  /** @param {number} question @param {string | null} objective */
  means(question, objective) {
    if (!this.read) return;
    this.meant = [...this.meant.filter((one) => one.question !== question), { question, objective }];
    const { weights, meant_weight } = this.read.got;
    const to = { ...weights };
    for (const one of this.meant) {
      if (!one.objective) continue;
      const ends = this.controls.sliders.map((slider) => this.controls.ends(slider)).find((some) => some.includes(one.objective ?? "")) ?? [];
      for (const end of ends) if (end !== one.objective) delete to[end];
      to[one.objective] = Math.max(to[one.objective] ?? 0, meant_weight);
    }
    this.controls.put(to, "words");
    this.tellWay(); // the same weights ask for no new way
    this.note();
    this.show();
  }

  /** @param {MouseEvent} event */
  clicked(event) {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    const resting = button?.getAttribute("aria-disabled") === "true";
    if (button && "read" in button.dataset) {
      if (!resting) void this.readIt();
      else if (!this.field.value.trim()) this.text("#live-way", this.own("write_first"));
    } else if (button && "done" in button.dataset && resting) {
      const what = !this.field.value.trim() ? "write_first" : !this.isRead ? "read_first" : "answer_first";
      this.needs.announce(this.own(what));
      this.text("#live-way", this.own(what));
    } else if (button && "reset" in button.dataset) {
      this.controls.put(this.read?.got.weights ?? {}, "words"); // back to what the words said
      this.meant = [];
      this.tellRead();
      this.tellWay();
      this.note();
      this.show();
    } else super.clicked(event);
  }

  async done() {
    if (!this.read) return;
    /** @type {import("../types.js").AnswerTo<"words">} */
    const value = { ...this.controls.answer(), sentence: this.read.sentence, meant: this.meant };
    await this.decide(value);
  }
}

/** @param {import("../kind.js").KindPage<"words">} page @returns {import("../kind.js").Mounted} */
export function mount(page) {
  const panel = /** @type {HTMLElement} */ (page.step.querySelector("#live-panel"));
  const { tell, language, keep, kept } = page;
  return { bar: new Wording(panel, { ...stageNeeds(page, "live"), tell, language, keep, kept }) };
}
