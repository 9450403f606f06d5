// @ts-check
/**
 * A ranking: every option on a place of its own. A press puts it on the next free place, a drag or the arrow keys on any
 * other. Nothing stands anywhere before the participant puts it there.
 */

/** How far (pixels) a pointer moves before a press becomes a drag. */
const DRAG_PX = 6;

/**
 * @param {HTMLElement} item
 * @param {(key: string, values?: Record<string, string | number>) => string} say
 */
export function readyRanking(item, say) {
  for (const card of cardsOf(item)) {
    card.addEventListener("click", () => press(card));
    card.addEventListener("keydown", (event) => byKey(card, event));
    card.addEventListener("pointerdown", (event) => grab(card, event));
    name(card);
  }

  /** @param {HTMLElement} card */
  function press(card) {
    if ("dropped" in card.dataset) return void delete card.dataset.dropped; // the click that ends a drag
    const free = placesOf(item).find((place) => !cardIn(place));
    if (placeOf(card)) put(card, null);
    else if (free) put(card, free);
  }

  /** @param {HTMLElement} card @param {KeyboardEvent} event */
  function byKey(card, event) {
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const places = placesOf(item);
    if (step === undefined) return;
    event.preventDefault();
    const now = placeOf(card);
    const to = now ? places[places.indexOf(now) + step] : places.find((place) => !cardIn(place));
    if (to) put(card, to);
  }

  /** Puts a card on a place, null for back to the others. Who stood there changes places with it.
   * @param {HTMLElement} card @param {HTMLElement | null} place */
  function put(card, place) {
    const from = placeOf(card);
    if (from === place) return;
    const there = place && cardIn(place);
    if (there && from) from.append(there);
    else if (there) pool(item).append(there);
    (place ?? pool(item)).append(card);
    for (const one of cardsOf(item)) name(one);
    card.focus({ preventScroll: true });
    /** @type {HTMLElement} */ (item.querySelector("[data-said]")).textContent = card.getAttribute("aria-label") ?? "";
    item.dispatchEvent(new Event("input", { bubbles: true }));
  }

  /** What a screen reader calls a card: its words and where it stands. @param {HTMLElement} card */
  function name(card) {
    const places = placesOf(item);
    const place = placeOf(card);
    const values = { label: card.textContent?.trim() ?? "", place: place ? places.indexOf(place) + 1 : 0, of: places.length };
    card.setAttribute("aria-label", say(place ? "ranked" : "not_ranked", values));
  }

  /** @param {HTMLElement} card @param {PointerEvent} down */
  function grab(card, down) {
    if (down.button !== 0) return;
    card.setPointerCapture(down.pointerId); // a quick hand leaves the card before its first move is heard
    const move = (/** @type {PointerEvent} */ event) => {
      const [x, y] = [event.clientX - down.clientX, event.clientY - down.clientY];
      if (!("dragged" in card.dataset) && Math.hypot(x, y) < DRAG_PX) return;
      card.dataset.dragged = "";
      card.style.translate = `${x}px ${y}px`;
      for (const place of placesOf(item)) place.toggleAttribute("data-aimed", covers(place, event));
    };
    const end = (/** @type {PointerEvent} */ event) => {
      card.removeEventListener("pointermove", move);
      card.removeEventListener("pointerup", end);
      card.removeEventListener("pointercancel", end);
      if (!("dragged" in card.dataset)) return;
      delete card.dataset.dragged;
      card.style.translate = "";
      for (const place of placesOf(item)) place.removeAttribute("data-aimed");
      if (event.type === "pointercancel") return;
      card.dataset.dropped = "";
      setTimeout(() => delete card.dataset.dropped); // where the browser sends no click after a drag
      put(card, placesOf(item).find((place) => covers(place, event)) ?? null);
    };
    card.addEventListener("pointermove", move);
    card.addEventListener("pointerup", end);
    card.addEventListener("pointercancel", end);
  }
}

/** The values on the places, best first, null where nothing stands. @param {HTMLElement} item @returns {(string | null)[]} */
export function ranked(item) {
  return placesOf(item).map((place) => cardIn(place)?.dataset.value ?? null);
}

/** Puts the cards where they stood. @param {HTMLElement} item @param {unknown} values as from `ranked` */
export function rerank(item, values) {
  if (!Array.isArray(values)) return;
  placesOf(item).forEach((place, i) => {
    const card = cardsOf(item).find((one) => one.dataset.value === values[i]);
    if (card) place.append(card);
  });
}

/** @param {HTMLElement} item @returns {HTMLElement[]} */
const cardsOf = (item) => [...item.querySelectorAll(/** @type {"button"} */ ("[data-value]"))];
/** @param {HTMLElement} item @returns {HTMLElement[]} */
const placesOf = (item) => [...item.querySelectorAll(/** @type {"li"} */ ("[data-place]"))];
/** @param {HTMLElement} item */
const pool = (item) => /** @type {HTMLElement} */ (item.querySelector("[data-pool]"));
/** @param {HTMLElement} place @returns {HTMLElement | null} */
const cardIn = (place) => place.querySelector("[data-value]");
/** @param {HTMLElement} card @returns {HTMLElement | null} */
const placeOf = (card) => card.closest("[data-place]");

/** @param {HTMLElement} place @param {PointerEvent} event */
function covers(place, event) {
  const box = place.getBoundingClientRect();
  return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
}
