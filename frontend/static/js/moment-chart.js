// @ts-check
/**
 * Scores over time with the moment under the cursor: by pointer, touch, or the slider below (arrow keys). Charts of one group
 * move together, so that two policies are read at the same moment.
 */

/** @typedef {{dt: number, left: number, width: number, at: number, lanes: {name: string, scores: number[]}[]}} Moments */

/** @type {Map<string, ((step: number) => void)[]>} */
const groups = new Map();

/** @param {HTMLElement} figure */
function follow(figure) {
  const svg = figure.querySelector("svg");
  const slider = /** @type {HTMLInputElement | null} */ (figure.querySelector("input[type=range]"));
  const stored = figure.querySelector("script[type='application/json']")?.textContent;
  if (!svg || !slider || !stored) return;
  /** @type {Moments} */
  const data = JSON.parse(stored);
  const cursor = svg.querySelector(".cursor");
  const values = [...svg.querySelectorAll(".lane-value")];
  const output = figure.querySelector("output");
  const last = Math.max(0, ...data.lanes.map((lane) => lane.scores.length - 1));
  const decimals = new Intl.NumberFormat(document.documentElement.lang, { minimumFractionDigits: 2, maximumFractionDigits: 2 });
  const seconds = new Intl.NumberFormat(document.documentElement.lang, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
  slider.max = String(last);

  /** @param {number} wanted */
  const show = (wanted) => {
    const step = Math.min(Math.max(wanted, 0), last);
    const x = String(data.left + (data.width * step) / Math.max(last, 1));
    cursor?.setAttribute("x1", x);
    cursor?.setAttribute("x2", x);
    data.lanes.forEach((lane, k) => {
      const score = lane.scores[Math.min(step, lane.scores.length - 1)];
      if (values[k]) values[k].textContent = decimals.format(score);
    });
    slider.value = String(step);
    slider.setAttribute("aria-valuetext", `${seconds.format(step * data.dt)} s`);
    if (output) output.textContent = `${seconds.format(step * data.dt)} s`;
  };

  const group = groups.get(figure.dataset.moments ?? "") ?? [];
  group.push(show);
  groups.set(figure.dataset.moments ?? "", group);
  /** @param {number} step */
  const all = (step) => group.forEach((one) => one(step));
  slider.addEventListener("input", () => all(Number(slider.value)));
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const at = ((event.clientX - box.left) / box.width) * svg.viewBox.baseVal.width;
    all(Math.round(((at - data.left) / data.width) * last));
  });
  show(data.at);
}

/** @param {ParentNode} root */
const followAll = (root) => {
  for (const figure of root.querySelectorAll("figure[data-moments]")) follow(/** @type {HTMLElement} */ (figure));
};
followAll(document);
document.addEventListener("part", (event) => followAll(/** @type {HTMLElement} */ (event.target)));
