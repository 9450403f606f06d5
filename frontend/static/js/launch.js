// @ts-check
/** Launch forms: once an artefact is chosen in the first list, the other lists offer what is of its setup. */

for (const form of document.querySelectorAll("form.launch")) {
  const offers = /** @type {NodeListOf<HTMLOptionElement | HTMLInputElement>} */ (form.querySelectorAll("[data-setup]"));
  const nameOf = (/** @type {HTMLOptionElement | HTMLInputElement} */ one) =>
    one instanceof HTMLInputElement ? one.name : one.closest("select")?.name;
  const isChosen = (/** @type {HTMLOptionElement | HTMLInputElement} */ one) =>
    one instanceof HTMLInputElement ? one.checked : one.selected;

  const fit = () => {
    const lead = [...offers].find(isChosen);
    for (const one of offers) {
      // one list alone (the members of an ensemble) has to fit itself
      const free = !lead || (nameOf(one) === nameOf(lead) && !(one instanceof HTMLInputElement));
      const fits = free || one.dataset.setup === lead.dataset.setup;
      one.disabled = !fits;
      const shown = one instanceof HTMLInputElement ? one.closest("label") : one;
      if (shown instanceof HTMLElement) shown.hidden = !fits;
      if (!fits && one instanceof HTMLOptionElement && one.selected) {
        const list = one.closest("select");
        if (list) list.value = [...list.options].find((other) => !other.disabled && other.value === "")?.value ?? "";
      }
    }
  };
  form.addEventListener("change", fit);
  fit();
}
