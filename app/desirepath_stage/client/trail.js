// @ts-check
/** Where the robot came from: a band on the floor behind it that fades with time. The mesh is the server's. */
(() => {
  "use strict";
  const PIECES = 60; // as in app/desirepath_stage/scene_nodes.py
  const LASTS_S = 7;
  const [HALF_M, HEIGHT_M, STRONGEST] = [0.045, 0.013, 225];
  const BEGINS_S = 1; // from nothing where the robot started

  /** @type {any} */
  let mesh = null;

  window.desirePath.trail = {
    /** @param {string} name of its mesh, "" where the scene has none */
    use(name) {
      [mesh] = name ? window.desirePath.viser.meshes(name) : [null];
      if (mesh) mesh.frustumCulled = false; // its corners leave the place that they were sent with
    },

    /** @param {Track} track @param {number} t the robot is there now, seconds */
    at(track, t) {
      if (!mesh) return;
      const { position, color } = mesh.geometry.attributes;
      const now = Math.min(t, track[track.length - 1][0]);
      const colour = window.desirePath.scheme.trail();
      const places = Array.from({ length: PIECES + 1 }, (_, k) =>
        window.desirePath.player.along(track, Math.max(0, now - (LASTS_S * k) / PIECES)));
      /** Both edges of the band there. @param {number} k */
      const edges = (k) => {
        const [a, b] = [places[Math.max(0, k - 1)], places[Math.min(PIECES, k + 1)]];
        const [dx, dy] = [a[0] - b[0], a[1] - b[1]];
        const size = Math.hypot(dx, dy) || Infinity;
        const [aside, along] = [(-HALF_M * dy) / size, (HALF_M * dx) / size];
        return [[places[k][0] + aside, places[k][1] + along], [places[k][0] - aside, places[k][1] - along]];
      };
      let [left, right] = edges(0);
      for (let k = 0; k < PIECES; k += 1) {
        const [nextLeft, nextRight] = edges(k + 1);
        [right, left, nextLeft, nextRight].forEach(([x, y], corner) => {
          position.array.set([x, y, HEIGHT_M], 3 * (4 * k + corner));
          const age = (k + (corner > 1 ? 1 : 0)) / PIECES;
          const strength = (1 - age) * Math.max(0, Math.min(1, (now - age * LASTS_S) / BEGINS_S));
          color.array.set([...colour, Math.round(STRONGEST * strength)], 4 * (4 * k + corner));
        });
        [left, right] = [nextLeft, nextRight];
      }
      position.needsUpdate = color.needsUpdate = true;
    },
  };
})();
