// @ts-check
/** A plain text field as the editor of a protocol, where CodeMirror is not installed. */

/** @param {HTMLTextAreaElement} area @param {() => void} typed @returns {import("./protocol-editor.js").TextEditor} */
export function plainText(area, typed) {
  area.addEventListener("input", (event) => {
    event.stopPropagation(); // the form need not ask: the draft is saved as one types
    typed();
  });
  return {
    get text() {
      return area.value;
    },
    set text(text) {
      if (text !== area.value) area.value = text;
    },
    show() {}, // the errors stand beside it, each with its line
    goTo(line) {
      const lines = area.value.split("\n");
      const start = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
      area.focus();
      area.setSelectionRange(start, start + (lines[line - 1] ?? "").length);
      area.scrollTop = (area.scrollHeight / lines.length) * Math.max(0, line - 4);
    },
  };
}
