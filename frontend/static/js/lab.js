// @ts-check
// What every signed-in page does in the browser: local times, copying, dialogs, live parts, typed confirmations.

const pad = (/** @type {number} */ number) => String(number).padStart(2, "0");

/**
 * Write every <time datetime> below `root` as ISO in the reader's own time zone.
 * @param {ParentNode} root
 */
export function localTimes(root) {
  for (const time of root.querySelectorAll("time[datetime]")) {
    const moment = new Date(/** @type {HTMLTimeElement} */ (time).dateTime);
    if (Number.isNaN(moment.getTime())) continue;
    const day = `${moment.getFullYear()}-${pad(moment.getMonth() + 1)}-${pad(moment.getDate())}`;
    const text = `${day} ${pad(moment.getHours())}:${pad(moment.getMinutes())}`;
    time.setAttribute("title", moment.toISOString());
    if (time.textContent !== text) time.textContent = text;
  }
}

const ROLES = { table: "table", thead: "rowgroup", tbody: "rowgroup", tr: "row", td: "cell" };

/**
 * Write the name of its column into every cell of a table that lab.css stacks on a phone, and what each part is, which
 * a browser forgets as soon as it is no longer laid out as a table.
 * @param {ParentNode} root
 */
export function nameColumns(root) {
  for (const table of root.querySelectorAll("table.stacks")) {
    if (!(table instanceof HTMLTableElement)) continue;
    const names = [...(table.tHead?.rows[0]?.cells ?? [])].map((head) => head.textContent?.trim() ?? "");
    for (const [tag, role] of Object.entries(ROLES)) {
      for (const part of [table, ...table.querySelectorAll(tag)]) if (part.matches(tag)) part.setAttribute("role", role);
    }
    for (const head of table.querySelectorAll("th")) {
      head.setAttribute("role", head.scope === "row" ? "rowheader" : "columnheader");
    }
    for (const row of table.tBodies[0]?.rows ?? []) {
      [...row.cells].forEach((cell, column) => {
        cell.dataset.column = names[column] ?? "";
        cell.toggleAttribute("data-none", cell.textContent?.trim() === "–");
      });
    }
    table.dataset.named = "";
  }
}

/** A form with data-unsaved asks before the page is left with edits that were not sent. */
function unsavedForms() {
  for (const form of document.querySelectorAll("form[data-unsaved]")) {
    let edited = false;
    form.addEventListener("input", () => (edited = true));
    form.addEventListener("submit", () => (edited = false));
    window.addEventListener("beforeunload", (event) => {
      if (edited) event.preventDefault();
    });
  }
}

/** Say below the page which time zone its times are in. */
function timeZone() {
  for (const note of document.querySelectorAll("[data-time-zone]")) {
    const zone = Intl.DateTimeFormat().resolvedOptions().timeZone;
    note.textContent = `${/** @type {HTMLElement} */ (note).dataset.timeZone ?? ""}${zone ? `: ${zone}` : ""}`;
  }
}

/** Buttons with data-copies="ID OF AN INPUT". */
function copyButtons() {
  document.addEventListener("click", async (event) => {
    const button = /** @type {HTMLElement} */ (event.target).closest("[data-copies]");
    if (!(button instanceof HTMLElement)) return;
    const source = document.getElementById(button.dataset.copies ?? "");
    const status = button.parentElement?.querySelector("[role=status]");
    if (!source || !status) return;
    const field = source instanceof HTMLInputElement || source instanceof HTMLTextAreaElement ? source : null;
    try {
      await navigator.clipboard.writeText(field ? field.value : source.textContent ?? "");
    } catch {
      // No clipboard on plain http: select, so that one key press copies.
      field?.select();
      return;
    }
    status.textContent = button.dataset.copied ?? "";
  });
}

/** Buttons with data-opens="ID OF A DIALOG", and data-closes inside it. */
function dialogs() {
  document.addEventListener("click", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    const opener = target.closest("[data-opens]");
    if (opener instanceof HTMLElement) {
      const dialog = document.getElementById(opener.dataset.opens ?? "");
      if (dialog instanceof HTMLDialogElement) dialog.showModal();
    }
    if (target.closest("[data-closes]")) target.closest("dialog")?.close();
  });
}

/** A form with data-typed-name="TEXT" can be sent once its field [data-typed] holds that text. The server checks too. */
function typedConfirmations() {
  for (const form of document.querySelectorAll("form[data-typed-name]")) {
    const typed = form.querySelector("[data-typed]");
    const button = form.querySelector("button[data-needs-typed]");
    if (!(form instanceof HTMLFormElement && typed instanceof HTMLInputElement && button instanceof HTMLButtonElement)) {
      continue;
    }
    const check = () => {
      button.disabled = typed.value.trim() !== form.dataset.typedName;
    };
    typed.addEventListener("input", check);
    check();
  }
}

/**
 * Parts with data-live="ADDRESS" are fetched again every data-every seconds while the page is seen; only a changed
 * part is replaced, and never while the reader's focus or selection is inside it. data-soon: the first time at once.
 */
function liveParts() {
  for (const part of document.querySelectorAll("[data-live]")) {
    if (!(part instanceof HTMLElement)) continue;
    let known = "";
    const note = document.querySelector("[data-live-note]");
    const refresh = async () => {
      if (document.hidden) return;
      try {
        const response = await fetch(part.dataset.live ?? "", { headers: { "X-Fragment": "1" } });
        if (response.redirected || response.status === 401) {
          window.location.reload();
          return;
        }
        if (!response.ok) throw new Error(String(response.status));
        const fresh = await response.text();
        if (note) note.textContent = note.getAttribute("data-fresh") ?? "";
        const selected = document.getSelection();
        const busy = part.contains(document.activeElement) || (selected && !selected.isCollapsed && part.contains(selected.anchorNode));
        if (fresh !== known && !busy) {
          part.innerHTML = fresh;
          localTimes(part);
          nameColumns(part);
          known = fresh;
        }
      } catch {
        if (note) note.textContent = note.getAttribute("data-stale") ?? "";
      }
    };
    if ("soon" in part.dataset) void refresh();
    window.setInterval(refresh, 1000 * Number(part.dataset.every ?? 3));
    document.addEventListener("visibilitychange", refresh);
  }
}

/** Forms with data-waits: once sent, their button says that it takes a while, until the page is left. */
function waitingForms() {
  document.addEventListener("submit", (event) => {
    const form = /** @type {HTMLFormElement} */ (event.target);
    const button = form.querySelector("button.main");
    if (!form.dataset.waits || !(button instanceof HTMLButtonElement)) return;
    const before = button.textContent;
    button.disabled = true;
    button.textContent = form.dataset.waits;
    window.addEventListener("pagehide", () => {
      button.disabled = false;
      button.textContent = before;
    }, { once: true });
  });
}

/** Links with data-png save the SVG that they lead to as a PNG, drawn here at twice its size. */
function pictures() {
  document.addEventListener("click", async (event) => {
    const link = /** @type {HTMLElement} */ (event.target).closest("a[data-png]");
    if (!(link instanceof HTMLAnchorElement)) return;
    event.preventDefault();
    const drawn = await (await fetch(link.href)).blob();
    const picture = new Image();
    picture.src = URL.createObjectURL(new Blob([drawn], { type: "image/svg+xml" }));
    await picture.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [picture.naturalWidth * 2, picture.naturalHeight * 2];
    canvas.getContext("2d")?.drawImage(picture, 0, 0, canvas.width, canvas.height);
    const saved = document.createElement("a");
    saved.href = canvas.toDataURL("image/png");
    saved.download = (new URL(link.href).pathname.split("/").pop() ?? "figure").replace(/\.svg$/, ".png");
    saved.click();
    URL.revokeObjectURL(picture.src);
  });
}

localTimes(document);
nameColumns(document);
timeZone();
document.querySelector(".lab-top [aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
unsavedForms();
copyButtons();
dialogs();
typedConfirmations();
waitingForms();
liveParts();
pictures();
