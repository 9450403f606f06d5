// @ts-check
/**
 * Where robots and people stand: who walks moves arms and legs as fast as they walk, and whatever is painted over the
 * picture leaves them out, so that a way lies under them.
 */
(() => {
  "use strict";
  const { viser } = window.desirePath;
  const STRIDE_M = 1.3; // left and right
  const FULL_M_S = 0.8; // limbs swing as far as they do from this speed on
  const EASE_S = 0.15;
  const JUMP_M = 0.6; // nobody walks so far from one picture to the next
  const CORNERS = 16;
  const PERSON = [0.26, 1.7]; // radius, height

  /** @typedef {{place: number[], size: number[], gait: number[] | null, at: number}} Body */
  /** @type {Map<string, Body>} */
  let bodies = new Map();
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  /** @param {Body} body @param {number} x @param {number} y */
  function walk(body, x, y) {
    const now = performance.now();
    const [seconds, gone] = [(now - body.at) / 1000, Math.hypot(x - body.place[0], y - body.place[1])];
    body.at = now;
    if (!body.gait) return;
    if (still.matches || !(gone < JUMP_M)) body.gait.fill(0);
    else if (seconds > 0) {
      const swing = Math.min(1, gone / seconds / FULL_M_S);
      body.gait[0] += (2 * Math.PI * gone) / STRIDE_M;
      body.gait[1] += (swing - body.gait[1]) * Math.min(1, seconds / EASE_S);
    }
  }

  /** The outline of points: the convex hull, counter-clockwise. @param {number[][]} points */
  function around(points) {
    const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const half = (/** @type {number[][]} */ some) => {
      /** @type {number[][]} */
      const kept = [];
      for (const [x, y] of some) {
        for (let n = kept.length; n > 1; n -= 1) {
          const [[ax, ay], [bx, by]] = [kept[n - 2], kept[n - 1]];
          if ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0) break;
          kept.pop();
        }
        kept.push([x, y]);
      }
      return kept.slice(0, -1);
    };
    return [...half(sorted), ...half(sorted.reverse())];
  }

  window.desirePath.bodies = {
    /** These stand in the scene. robotSize: [radius, height], m. @param {string[]} robots @param {string[]} people @param {number[]} robotSize */
    use(robots, people, robotSize) {
      bodies = new Map();
      const add = (/** @type {string} */ name, /** @type {number[]} */ size, /** @type {number[] | null} */ gait) =>
        bodies.set(name, { place: [NaN, NaN, 0], size, gait, at: 0 });
      for (const name of robots) add(name, robotSize, null);
      for (const name of people) add(name, PERSON, viser.gait(name));
    },

    /** @param {string} name @param {number} x @param {number} y @param {number} yaw */
    put(name, x, y, yaw) {
      const body = bodies.get(name);
      if (body) {
        walk(body, x, y);
        body.place = [x, y, yaw];
      }
      viser.pose(name, x, y, yaw);
    },

    /** Takes off a painting what lies behind bodies: as if it were on the floor. @param {CanvasRenderingContext2D} pen @param {Projector} project */
    uncover(pen, project) {
      pen.save();
      pen.globalCompositeOperation = "destination-out";
      for (const { place: [x, y], size: [radius, height], gait } of bodies.values()) {
        if (!Number.isFinite(x) || (gait && document.documentElement.dataset.view !== "top_down")) continue;
        const corners = [0, height].flatMap((z) => Array.from({ length: CORNERS }, (_, k) => {
          const angle = (2 * Math.PI * k) / CORNERS;
          return project(x + radius * Math.cos(angle), y + radius * Math.sin(angle), z);
        }));
        if (corners.some((corner) => !corner)) continue;
        pen.beginPath();
        for (const [px, py] of around(/** @type {number[][]} */ (corners))) pen.lineTo(px, py);
        pen.fill();
      }
      pen.restore();
    },
  };
})();
