// @ts-check
// The page of all policies: drawings that were not made yet are asked for again, and folded groups stay as they were left.

const TRIES = 6;

/** @param {HTMLImageElement} image */
function again(image) {
  const tries = Number(image.dataset.tries ?? 0) + 1;
  if (tries > TRIES) return;
  image.dataset.tries = String(tries);
  setTimeout(() => {
    const source = image.parentElement?.querySelector("source");
    if (source) source.srcset = `${source.srcset.replace(/&try=.*/, "")}&try=${tries}`;
    image.src = `${image.src.replace(/[?]try=.*/, "")}?try=${tries}`;
  }, 1500 * tries);
}

for (const image of document.querySelectorAll("img[data-sketch]")) {
  if (!(image instanceof HTMLImageElement)) continue;
  image.addEventListener("error", () => again(image));
  if (image.complete && !image.naturalWidth && image.getClientRects().length) again(image);
}

for (const fold of document.querySelectorAll("details[data-fold]")) {
  if (!(fold instanceof HTMLDetailsElement)) continue;
  const key = `desirepath.fold.${fold.id}`;
  try {
    const left = sessionStorage.getItem(key);
    if (left) fold.open = left === "open";
  } catch {
    // storage is switched off: groups are as the page comes
  }
  fold.addEventListener("toggle", () => {
    try {
      sessionStorage.setItem(key, fold.open ? "open" : "folded");
    } catch {
      // as above
    }
  });
}
if (location.hash) {
  const meant = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (meant instanceof HTMLDetailsElement) meant.open = true;
}
