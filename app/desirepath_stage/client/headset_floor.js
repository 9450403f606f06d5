// @ts-check
/**
 * What scripts of ours paint over the window (overlay.js: strokes, ways, a mirrored robot) lies on the floor for who wears
 * a headset: the same canvases, as large as the room, on squares under everything that stands there.
 */
(() => {
  "use strict";
  const { quads } = window.desirePath;
  const [PX_PER_M, MOST_PX] = [120, 1280]; // words of 15 px are an eighth of a metre; a texture that changes while one draws
  const AROUND_M = 0.4;
  const ABOVE_M = 0.02; // over the floor and what is painted on it
  const REST_MS = 60; // between two pictures: each is a texture that goes to the graphics anew

  /** @type {Lying | null} */
  let lies = null;
  /** @type {Map<HTMLCanvasElement, {mesh: any, at: number}>} */
  let sheets = new Map();
  /** @type {{middle: number[], right: number[], up: number[]}} */
  let edges = { middle: [0, 0, 0], right: [1, 0, 0], up: [0, 1, 0] };

  window.desirePath.headsetFloor = {
    /** Where and how canvases lie; null: over the window. */
    lies: () => lies,

    /** From now on they lie on this scene's floor, upright for who stands there. @param {Orders["camera"]} camera */
    lay({ frame, eye, target }) {
      this.lift();
      const [xMin, yMin, xMax, yMax] = [
        Math.min(frame[0], eye[0]) - AROUND_M, Math.min(frame[1], eye[1]) - AROUND_M,
        Math.max(frame[2], eye[0]) + AROUND_M, Math.max(frame[3], eye[1]) + AROUND_M,
      ];
      const quarter = (Math.round(Math.atan2(target[1] - eye[1], target[0] - eye[0]) / (Math.PI / 2)) * Math.PI) / 2;
      const up = [Math.round(Math.cos(quarter)), Math.round(Math.sin(quarter)), 0];
      const right = [up[1], -up[0], 0];
      const middle = [(xMin + xMax) / 2, (yMin + yMax) / 2, ABOVE_M];
      const along = (/** @type {number[]} */ way) => Math.abs(way[0]) * (xMax - xMin) + Math.abs(way[1]) * (yMax - yMin);
      const [width, height] = [along(right) * PX_PER_M, along(up) * PX_PER_M];
      edges = { middle, right: right.map((v) => v * along(right)), up: up.map((v) => v * along(up)) };
      lies = {
        width,
        height,
        density: Math.min(1, MOST_PX / Math.max(width, height)),
        project: (x, y) => {
          const [dx, dy] = [x - middle[0], y - middle[1]];
          return [width / 2 + PX_PER_M * (dx * right[0] + dy * right[1]), height / 2 - PX_PER_M * (dx * up[0] + dy * up[1])];
        },
      };
    },

    /** They lie over the window again. */
    lift() {
      for (const { mesh } of sheets.values()) quads.drop(mesh);
      sheets = new Map();
      lies = null;
    },

    /** Whether a canvas may be painted anew now. @param {HTMLCanvasElement} canvas */
    due(canvas) {
      return !lies || performance.now() - (sheets.get(canvas)?.at ?? -Infinity) >= REST_MS;
    },

    /** A canvas that lies here is being painted anew. @param {HTMLCanvasElement} canvas */
    painted(canvas) {
      let sheet = sheets.get(canvas);
      if (!sheet) {
        sheet = { mesh: quads.make(5, true), at: 0 };
        sheets.set(canvas, sheet);
        quads.picture(sheet.mesh, canvas);
      }
      sheet.at = performance.now();
      sheet.mesh.material.map.needsUpdate = true;
      quads.put(sheet.mesh, edges.middle, edges.right, edges.up);
    },

    /** One picture: a canvas that is no longer used is not seen here either. */
    draw() {
      for (const [canvas, { mesh }] of sheets) mesh.visible = canvas.isConnected;
    },
  };
})();
