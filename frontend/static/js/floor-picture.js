// @ts-check
/** A place from above as a small picture: walls, furniture, the person, where a rule applies, and ways of the robot. */

/** @typedef {import("./contract.js").FloorPicture} Floor */
/** @typedef {number[][]} Points x, y in metres */

const AROUND_M = 1;
const SVG = "http://www.w3.org/2000/svg";

/** @param {string} name @param {Record<string, string | number>} attributes @returns {SVGElement} */
function drawn(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  return element;
}

/** @param {Points} points */
const listed = (points) => points.map(([x, y]) => `${x},${-y}`).join(" ");

/**
 * @param {Floor} floor
 * @param {{zones?: Points[], holds?: Points[], path?: Points, label: string, near?: boolean}} shows near: only the part around person and path
 * @returns {SVGSVGElement}
 */
export function floorPicture(floor, { zones = [], holds = [], path = [], label, near = false }) {
  const seen = [...path, floor.person, floor.start, floor.goal];
  /** @param {number} axis @param {number} sign @param {number} edge */
  const end = (axis, sign, edge) => (near ? sign * Math.min(Math.max(...seen.map((at) => sign * at[axis])) + AROUND_M, sign * edge) : edge);
  const [x, y] = [end(0, -1, floor.low[0]), end(1, -1, floor.low[1])];
  const [right, top] = [end(0, 1, floor.high[0]), end(1, 1, floor.high[1])];
  const svg = /** @type {SVGSVGElement} */ (
    drawn("svg", { class: "floor-picture", viewBox: `${x} ${-top} ${right - x} ${top - y}`, role: "img", "aria-label": label })
  );
  /** @param {Points[]} areas @param {string} css */
  const areas = (areas, css) => areas.forEach((area) => svg.append(drawn("polygon", { class: css, points: listed(area) })));
  areas(holds, "holds");
  areas(floor.things, "thing");
  areas(floor.walls, "wall");
  areas(zones, "zone");
  const [px, py, yaw] = floor.person;
  if (floor.does === "sits") svg.append(drawn("rect", { class: "thing", x: px - 0.35, y: -py - 0.35, width: 0.7, height: 0.7 }));
  svg.append(drawn("circle", { class: "person", cx: px, cy: -py, r: 0.26 }));
  svg.append(drawn("line", { class: "facing", x1: px, y1: -py, x2: px + 0.6 * Math.cos(yaw), y2: -py - 0.6 * Math.sin(yaw) }));
  if (path.length) svg.append(drawn("polyline", { class: "way", points: listed(path) }));
  svg.append(drawn("circle", { class: "start", cx: floor.start[0], cy: -floor.start[1], r: 0.18 }));
  svg.append(drawn("circle", { class: "goal", cx: floor.goal[0], cy: -floor.goal[1], r: 0.3 }));
  return svg;
}

/** Where a pointer is on the floor, m. @param {SVGSVGElement} svg @param {PointerEvent} event @returns {[number, number]} */
export function onFloor(svg, event) {
  const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM()?.inverse());
  return [at.x, -at.y];
}
