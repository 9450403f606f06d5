// @ts-check
/**
 * What a policy with attention looks at while it drives: of each lidar sector a blue wedge on the floor, of each
 * descriptor ray a red line above it, as strong and as long as its weight beside the strongest of the moment (at the
 * policy's own 5 Hz). Wedge and line tell the two apart without colour.
 *
 * The mesh is the server's (app/desirepath_stage/explained_nodes.py); here its corners are moved, as in explained.js.
 */
(() => {
  "use strict";
  const { viser } = window.desirePath;
  const STEP_S = 0.2; // of the weights
  const [FLOOR_M, RAY_M] = [0.02, 0.22]; // heights
  const [WEDGE, RAY] = [[0.5, 1.3], [0.4, 2.0]]; // how far out from the robot, metres: of no weight, of the strongest
  const WIDE_M = 0.07; // of the strongest ray's end
  const [BLUE, RED] = [[35, 90, 200], [200, 34, 26]];
  const CORNERS = 4;

  /** @typedef {NonNullable<NonNullable<Orders["show"]["explained"]>["attention"]>} Attention */
  /** @type {Attention | null} */
  let order = null;
  /** @type {any} */
  let mesh = null;

  /** @param {number} quad @param {number[][]} corners @param {number[]} colour */
  function draw(quad, corners, colour) {
    const { position, color } = mesh.geometry.attributes;
    corners.forEach((corner, k) => {
      position.array.set(corner, 3 * (quad * CORNERS + k));
      color.array.set(colour, 4 * (quad * CORNERS + k));
    });
  }

  /** @param {number[]} weights of a moment */
  const strengths = (weights) => weights.map((weight) => weight / Math.max(...weights, 1e-9));

  window.desirePath.attention = {
    /** @param {Attention | null} given */
    use(given) {
      order = given;
      mesh = given ? viser.meshes(given.mesh)[0] ?? null : null;
      if (mesh) mesh.frustumCulled = false;
    },

    /** @param {number} t seconds @param {number} x @param {number} y @param {number} yaw the robot is here then */
    at(t, x, y, yaw) {
      if (!order || !mesh) return;
      const { spatial, temporal, radius } = order;
      const rows = Math.max(spatial.length, temporal.length);
      const now = Math.max(0, Math.min(rows - 1, Math.floor(t / STEP_S + 1e-6)));
      const sectors = strengths(spatial[now] ?? []);
      const width = (2 * Math.PI) / sectors.length;
      sectors.forEach((strength, k) => {
        const [from, to] = [yaw + k * width, yaw + (k + 1) * width];
        const far = radius + WEDGE[0] + (WEDGE[1] - WEDGE[0]) * strength;
        const at = (/** @type {number} */ out, /** @type {number} */ angle) => [x + out * Math.cos(angle), y + out * Math.sin(angle), FLOOR_M];
        draw(k, [at(radius, from), at(far, from), at(far, to), at(radius, to)], [...BLUE, Math.round(20 + 190 * strength)]);
      });
      const first = sectors.length;
      const rays = strengths(temporal[now] ?? []);
      rays.forEach((strength, k) => {
        const angle = yaw + (2 * Math.PI * k) / rays.length;
        const [c, s] = [Math.cos(angle), Math.sin(angle)];
        const [far, half] = [radius + RAY[0] + (RAY[1] - RAY[0]) * strength, (WIDE_M * (0.15 + strength)) / 2];
        const at = (/** @type {number} */ out, /** @type {number} */ beside) => [x + out * c - beside * s, y + out * s + beside * c, RAY_M];
        draw(first + k, [at(radius, -half / 2), at(far, -half), at(far, half), at(radius, half / 2)], [...RED, Math.round(25 + 210 * strength)]);
      });
      mesh.geometry.attributes.position.needsUpdate = true;
      mesh.geometry.attributes.color.needsUpdate = true;
    },

    /** @param {boolean} on */
    hide(on) {
      if (mesh) mesh.visible = !on;
    },
  };
})();
