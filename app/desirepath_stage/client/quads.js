// @ts-check
/**
 * Squares in the room for who wears a headset, made of the one that every scene brings along: panels, rays, dots, sheets.
 * What is on them is headset_room.js's and headset_floor.js's.
 */
(() => {
  "use strict";
  const { viser } = window.desirePath;
  const LINEAR = 1006; // three.js's LinearFilter
  /** @type {any} the scene's own */
  let square = null;

  const add = (/** @type {number[]} */ a, /** @type {number[]} */ b, by = 1) => a.map((value, i) => value + by * b[i]);
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (/** @type {number[]} */ a, /** @type {number[]} */ b) =>
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (/** @type {number[]} */ a) => a.map((value) => value / (Math.hypot(...a) || 1));

  window.desirePath.quads = {
    add,
    dot,
    cross,
    unit,

    /** @param {string} name of the square in this scene @returns {boolean} whether it is there */
    use(name) {
      square = viser.meshes(name)[0] ?? square;
      return Boolean(square);
    },

    /** @param {number} order of drawing, later over earlier @param {boolean} [hides] whether what stands before it hides it */
    make(order, hides = false) {
      const mesh = new square.constructor(square.geometry.clone(), square.material.clone());
      Object.assign(mesh, { matrixAutoUpdate: false, frustumCulled: false, visible: false, renderOrder: order });
      Object.assign(mesh.material, { map: null, transparent: true, depthTest: hides, depthWrite: false, side: 2 });
      viser.world().add(mesh);
      return mesh;
    },

    /** Shows what is painted on a canvas. @param {any} mesh @param {HTMLCanvasElement} canvas */
    picture(mesh, canvas) {
      const Texture = square.material.map.constructor;
      mesh.material.map?.dispose();
      mesh.material.map = Object.assign(new Texture(canvas), { flipY: false, generateMipmaps: false, minFilter: LINEAR, needsUpdate: true });
      mesh.material.needsUpdate = true;
    },

    /** @param {any} mesh @param {number[]} at its middle @param {number[]} x @param {number[]} y edges, as long as they are */
    put(mesh, at, x, y) {
      const z = unit(cross(x, y));
      mesh.matrix.set(x[0], y[0], z[0], at[0], x[1], y[1], z[1], at[1], x[2], y[2], z[2], at[2], 0, 0, 0, 1);
      mesh.visible = true;
    },

    /** @param {any} mesh that is needed no more */
    drop(mesh) {
      mesh.parent?.remove(mesh);
      mesh.geometry.dispose();
      mesh.material.map?.dispose();
      mesh.material.dispose();
    },
  };
})();
