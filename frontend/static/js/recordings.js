// @ts-check
// Sends files of recordings one after the other, straight to the server's disk, and waits while they are read.

const POLL_MS = 1500;

/** @param {HTMLFormElement} form */
function uploads(form) {
  const problem = /** @type {HTMLElement} */ (form.querySelector("#upload-problem"));
  const progress = /** @type {HTMLProgressElement} */ (form.querySelector("#sent"));
  const button = /** @type {HTMLButtonElement} */ (form.querySelector("button"));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const chosen = ["files", "answers"].flatMap((id) =>
      [...(/** @type {HTMLInputElement} */ (form.querySelector(`#${id}`)).files ?? [])].map((file) => ({ file, answers: id === "answers" })),
    );
    if (!chosen.length) return;
    const total = chosen.reduce((sum, { file }) => sum + file.size, 0) || 1;
    let before = 0;
    let draft = form.dataset.draft ?? "";
    let href = location.pathname;
    button.disabled = true;
    problem.hidden = true;
    progress.hidden = false;
    try {
      for (const { file, answers } of chosen) {
        const taken = await sendFile(file, { draft, answers, csrf: form.dataset.csrf ?? "" }, (sent) => (progress.value = (before + sent) / total));
        ({ draft, href } = taken);
        form.dataset.draft = draft; // what follows a refusal goes to the same upload
        before += file.size;
      }
      location.assign(href);
      if (location.pathname === href) location.reload();
    } catch (error) {
      problem.textContent = error instanceof Error && error.message ? error.message : form.dataset.failed ?? "";
      problem.hidden = false;
      progress.hidden = true;
      button.disabled = false;
    }
  });
}

/**
 * @param {File} file
 * @param {{draft: string, answers: boolean, csrf: string}} to
 * @param {(bytes: number) => void} tell how much has been sent
 * @returns {Promise<{draft: string, href: string}>}
 */
function sendFile(file, { draft, answers, csrf }, tell) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest(); // fetch does not say how much of a body is sent
    const query = new URLSearchParams({ name: file.name, draft, answers: String(answers) });
    request.open("POST", `/api/lab/recordings/files?${query}`);
    request.setRequestHeader("X-CSRF", csrf);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.addEventListener("progress", (event) => tell(event.loaded));
    request.addEventListener("error", () => reject(new Error()));
    request.addEventListener("load", () => {
      let reply = null;
      try {
        reply = JSON.parse(request.responseText);
      } catch {
        // a proxy's own page
      }
      if (request.status === 200 && reply) resolve(reply);
      else reject(new Error(reply?.error?.message ?? ""));
    });
    request.send(file);
  });
}

/** @param {HTMLElement} note with the address that says whether files are still being read */
function waits(note) {
  const look = async () => {
    try {
      const response = await fetch(note.dataset.reading ?? "");
      /** @type {{working: boolean}} */
      const state = await response.json();
      if (!response.ok || !state.working) location.reload();
    } catch {
      // the connection is away: asked again
    }
  };
  setInterval(look, POLL_MS);
}

for (const form of document.querySelectorAll("form#upload")) uploads(/** @type {HTMLFormElement} */ (form));
for (const note of document.querySelectorAll("[data-reading]")) waits(/** @type {HTMLElement} */ (note));
