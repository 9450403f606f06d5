// @ts-check
/**
 * CodeMirror 6 over a text field: errors at their lines, completion by the published schema. Its modules are copied to
 * static/npm by scripts/browser_modules.mjs, as they are published; they are not in the repository.
 */

import { suggest } from "./yaml-completion.js";

/** @template T @param {Promise<T>} given @returns {Promise<T>} */
const of = (given) => given;

/**
 * @param {HTMLTextAreaElement} area stays, hidden, as the form's field
 * @param {import("./protocol-editor.js").Known} known
 * @param {() => void} typed
 * @returns {Promise<import("./protocol-editor.js").TextEditor>}
 */
export async function codeMirror(area, known, typed) {
  const [state, view, language, commands, autocomplete, lint, yaml, highlight] = await Promise.all([
    of(/** @type {Promise<typeof import("@codemirror/state")>} */ (module("codemirror-state"))),
    of(/** @type {Promise<typeof import("@codemirror/view")>} */ (module("codemirror-view"))),
    of(/** @type {Promise<typeof import("@codemirror/language")>} */ (module("codemirror-language"))),
    of(/** @type {Promise<typeof import("@codemirror/commands")>} */ (module("codemirror-commands"))),
    of(/** @type {Promise<typeof import("@codemirror/autocomplete")>} */ (module("codemirror-autocomplete"))),
    of(/** @type {Promise<typeof import("@codemirror/lint")>} */ (module("codemirror-lint"))),
    of(/** @type {Promise<typeof import("@codemirror/lang-yaml")>} */ (module("codemirror-lang-yaml"))),
    of(/** @type {Promise<typeof import("@lezer/highlight")>} */ (module("lezer-highlight"))),
  ]);
  const { EditorView } = view;
  const { tags } = highlight;
  const fromOutside = state.Annotation.define();
  const holder = document.createElement("div");
  holder.className = "code-mirror";
  area.after(holder);
  area.hidden = true;
  // In a shadow tree its styles are sheets made by the script, which the page's policy allows; <style> it does not.
  const inside = holder.attachShadow({ mode: "open" });
  const colours = language.HighlightStyle.define([
    { tag: [tags.propertyName, tags.definition(tags.propertyName)], color: "var(--accent-text)" },
    { tag: tags.comment, color: "var(--ink-soft)", fontStyle: "italic" },
    { tag: [tags.string, tags.content], color: "var(--ink)" },
  ]);
  const look = EditorView.theme({
    "&": { height: "100%", color: "var(--ink)", backgroundColor: "var(--raised)", fontSize: "var(--text-s)" },
    ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.5" },
    "&.cm-focused": { outline: "3px solid var(--focus)", outlineOffset: "1px" },
    ".cm-content": { caretColor: "var(--ink)" },
    ".cm-cursor": { borderLeftColor: "var(--ink)" },
    ".cm-gutters": { backgroundColor: "var(--sunken)", color: "var(--ink-soft)", border: "none" },
    ".cm-activeLine, .cm-activeLineGutter": { backgroundColor: "var(--accent-wash)" },
    "&.cm-focused > .cm-scroller > .cm-selectionLayer .cm-selectionBackground, .cm-selectionBackground": { backgroundColor: "color-mix(in srgb, var(--focus) 30%, transparent)" },
    ".cm-tooltip": { backgroundColor: "var(--raised)", color: "var(--ink)", border: "1px solid var(--edge)" },
    ".cm-tooltip-autocomplete ul li[aria-selected]": { backgroundColor: "var(--accent)", color: "var(--on-accent)" },
    ".cm-completionDetail": { fontStyle: "normal", opacity: "0.8" },
    ".cm-diagnostic": { fontFamily: "var(--sans)", whiteSpace: "pre-wrap", maxWidth: "34rem" },
    ".cm-diagnostic-error": { borderLeftColor: "var(--error)" },
    ".cm-lintRange-error": { backgroundImage: "none", textDecoration: "underline wavy var(--error)" },
  });
  const editor = new EditorView({
    parent: inside,
    root: inside,
    doc: area.value,
    extensions: [
      view.lineNumbers(),
      view.highlightActiveLine(),
      view.drawSelection(),
      commands.history(),
      language.indentOnInput(),
      language.bracketMatching(),
      autocomplete.closeBrackets(),
      state.EditorState.tabSize.of(2),
      yaml.yaml(),
      language.syntaxHighlighting(colours),
      autocomplete.autocompletion({
        override: [(context) => {
          const line = context.state.doc.lineAt(context.pos);
          const found = suggest(context.state.sliceDoc(0, context.pos), known, context.state.sliceDoc(context.pos, line.to));
          if (!found || (!context.explicit && found.from === context.pos && found.typing)) return null;
          return { from: found.from, options: found.options, validFor: /^[\w./-]*$/ };
        }],
      }),
      lint.lintGutter(),
      view.keymap.of([...autocomplete.completionKeymap, ...autocomplete.closeBracketsKeymap, ...commands.defaultKeymap, ...commands.historyKeymap, ...lint.lintKeymap]),
      EditorView.contentAttributes.of({ tabindex: "0", "aria-label": area.labels[0]?.textContent?.trim() ?? "YAML" }),
      EditorView.updateListener.of((update) => {
        if (!update.docChanged) return;
        area.value = update.state.doc.toString();
        if (update.transactions.some((one) => one.annotation(fromOutside))) return;
        typed();
      }),
      look,
    ],
  });
  return {
    get text() {
      return editor.state.doc.toString();
    },
    set text(text) {
      const before = editor.state.doc.toString();
      if (text === before) return;
      let from = 0;
      while (from < Math.min(text.length, before.length) && text[from] === before[from]) from++;
      let end = 0;
      while (end < Math.min(text.length, before.length) - from && text.at(-1 - end) === before.at(-1 - end)) end++;
      const changes = { from, to: before.length - end, insert: text.slice(from, text.length - end) };
      editor.dispatch({ changes, annotations: fromOutside.of(true) }); // Ctrl+Z takes a form's change back, too
    },
    show(problems) {
      const { doc } = editor.state;
      const diagnostics = problems.map(({ line, message }) => {
        const at = doc.line(Math.min(Math.max(line, 1), doc.lines));
        const indent = at.text.length - at.text.trimStart().length;
        return { from: at.from + indent, to: at.to, severity: /** @type {"error"} */ ("error"), message };
      });
      editor.dispatch(lint.setDiagnostics(editor.state, diagnostics));
    },
    goTo(line) {
      const at = editor.state.doc.line(Math.min(Math.max(line, 1), editor.state.doc.lines));
      editor.dispatch({ selection: { anchor: at.to }, effects: EditorView.scrollIntoView(at.from, { y: "center" }) });
    },
  };
}

/** @param {string} name @returns {Promise<any>} */
const module = (name) => import(`../npm/${name}.js`);
