// @ts-check
/**
 * A triangle in which three weights are set against each other: in whole percent, together 100. By dragging the dot
 * (mouse, touch, pen), by its arrow keys, or by pressing a corner for more of it. What they are for is controls.js's.
 */

/** @typedef {{[objective: string]: number}} Weights */

/** The corners in the picture, as in weights.html: above, left, right. */
const PICTURE = { width: 200, height: 176 };
const CORNERS = [[100, 8], [8, 168], [192, 168]];
const STEP = 10; // of 100, that a press on a corner brings it
const PIXELS = 6; // of the picture, by an arrow key; one with Shift
/** @type {Record<string, number[]>} */
const ARROWS = { ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };

/** @param {number[]} shares not negative, not all 0 @returns {number[]} whole percent, together 100 */
export function percents(shares) {
  const together = shares.reduce((sum, share) => sum + share, 0);
  const exact = shares.map((share) => (100 * share) / together);
  const whole = exact.map(Math.floor);
  const order = exact.map((_, i) => i).sort((a, b) => exact[b] - whole[b] - (exact[a] - whole[a]));
  const missing = 100 - whole.reduce((sum, share) => sum + share, 0);
  return whole.map((share, i) => share + (order.indexOf(i) < missing ? 1 : 0));
}

/** The shares of a place in the picture, of the nearest one in the triangle where it lies outside. @param {number} x @param {number} y */
export function sharesAt(x, y) {
  const [[ax, ay], [bx, by], [cx, cy]] = CORNERS;
  const whole = (by - cy) * (ax - cx) + (cx - bx) * (ay - cy);
  const a = ((by - cy) * (x - cx) + (cx - bx) * (y - cy)) / whole;
  const b = ((cy - ay) * (x - cx) + (ax - cx) * (y - cy)) / whole;
  const shares = [a, b, 1 - a - b];
  if (shares.every((share) => share >= 0)) return shares;
  const sides = [[0, 1], [1, 2], [2, 0]].map(([i, j]) => {
    const [[px, py], [qx, qy]] = [CORNERS[i], CORNERS[j]];
    const along = ((x - px) * (qx - px) + (y - py) * (qy - py)) / ((qx - px) ** 2 + (qy - py) ** 2);
    const t = Math.max(0, Math.min(1, along));
    const shares = [0, 0, 0];
    [shares[i], shares[j]] = [1 - t, t];
    return { shares, away: Math.hypot(px + t * (qx - px) - x, py + t * (qy - py) - y) };
  });
  return sides.sort((one, other) => one.away - other.away)[0].shares;
}

export class Triangle {
  /**
   * @param {HTMLElement} root
   * @param {object} listening
   * @param {(weights: Weights) => void} listening.moved by the hand
   * @param {() => void} listening.settled the hand has let go
   */
  constructor(root, { moved, settled }) {
    this.root = root;
    this.moved = moved;
    this.settled = settled;
    this.names = (root.dataset.triangle ?? "").split(" ");
    this.shares = [34, 33, 33];
    this.field = /** @type {SVGElement} */ (root.querySelector("svg.triangle-field"));
    this.handle = /** @type {HTMLElement} */ (root.querySelector("[data-handle]"));
    this.corners = /** @type {HTMLElement[]} */ ([...root.querySelectorAll("[data-corner]")]);
    this.dragging = false;
    for (const grip of [this.field, this.handle]) grip.addEventListener("pointerdown", (event) => this.grip(/** @type {PointerEvent} */ (event)));
    root.addEventListener("pointermove", (event) => this.dragging && this.pull(event));
    for (const type of ["pointerup", "pointercancel"]) root.addEventListener(type, () => this.release());
    this.handle.addEventListener("keydown", (event) => this.key(event));
    this.corners.forEach((corner, i) => corner.addEventListener("click", () => this.more(i)));
    this.show();
  }

  /** @returns {Weights} */
  get weights() {
    return Object.fromEntries(this.names.map((name, i) => [name, this.shares[i] / 100]).filter(([, weight]) => weight));
  }

  /** What it stands at; what it cannot show is left out. @param {Weights} weights */
  put(weights) {
    const wanted = this.names.map((name) => weights[name] ?? 0);
    this.shares = wanted.some((share) => share > 0) ? percents(wanted) : percents([1, 1, 1]);
    this.show();
    return this.weights;
  }

  /** @param {number[]} shares by the hand */
  take(shares) {
    const whole = percents(shares);
    if (whole.every((share, i) => share === this.shares[i])) return;
    this.shares = whole;
    this.show();
    this.moved(this.weights);
  }

  /** @param {PointerEvent} event */
  grip(event) {
    if (event.button > 0) return;
    event.preventDefault();
    this.root.setPointerCapture(event.pointerId);
    this.dragging = true;
    this.handle.focus({ preventScroll: true });
    this.pull(event);
  }

  /** @param {PointerEvent} event */
  pull(event) {
    const box = this.field.getBoundingClientRect();
    this.take(sharesAt(((event.clientX - box.left) / box.width) * PICTURE.width, ((event.clientY - box.top) / box.height) * PICTURE.height));
  }

  release() {
    if (!this.dragging) return;
    this.dragging = false;
    this.settled();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const way = ARROWS[event.key];
    if (!way && event.key !== "Home") return;
    event.preventDefault();
    const [x, y] = this.spot();
    const pixels = event.shiftKey ? 1 : PIXELS;
    this.take(way ? sharesAt(x + way[0] * pixels, y + way[1] * pixels) : [1, 1, 1]);
    this.settled();
  }

  /** More of one, less of the others in proportion. @param {number} i */
  more(i) {
    const [now, wanted] = [this.shares[i], Math.min(100, this.shares[i] + STEP)];
    this.take(this.shares.map((share, k) => (k === i ? wanted : now < 100 ? (share * (100 - wanted)) / (100 - now) : 0)));
    this.settled();
  }

  /** Where the dot is in the picture. */
  spot() {
    return [0, 1].map((axis) => this.shares.reduce((sum, share, i) => sum + (share / 100) * CORNERS[i][axis], 0));
  }

  show() {
    const [x, y] = this.spot();
    this.handle.style.setProperty("--x", String(x / PICTURE.width));
    this.handle.style.setProperty("--y", String(y / PICTURE.height));
    this.root.querySelectorAll("[data-pull]").forEach((pull, i) => {
      pull.setAttribute("d", `M${CORNERS[i].join(" ")}L${x.toFixed(1)} ${y.toFixed(1)}`);
      pull.setAttribute("stroke-width", String(this.shares[i] / 12));
    });
    const words = this.corners.map((corner, i) => {
      const share = /** @type {HTMLElement} */ (corner.querySelector("[data-share]"));
      share.textContent = String(this.shares[i]);
      corner.toggleAttribute("data-on", this.shares[i] > 0 && this.shares[i] === Math.max(...this.shares));
      return `${corner.querySelector("[data-name]")?.textContent}: ${this.shares[i]}`;
    });
    this.handle.setAttribute("aria-valuenow", String(this.shares[0]));
    this.handle.setAttribute("aria-valuetext", words.join(", "));
  }
}
