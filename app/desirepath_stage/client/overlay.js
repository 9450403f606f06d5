// @ts-check
/**
 * Canvases of our own over viser's picture, as large as the window; for who wears a headset they lie on the floor
 * (headset_floor.js).
 */
(() => {
  "use strict";
  const MOST_PIXELS_PER_POINT = 2;

  /** @param {string} id @returns {Overlay} */
  window.desirePath.overlay = (id) => {
    const canvas = document.createElement("canvas");
    canvas.id = id;
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    const lies = () => window.desirePath.headsetFloor.lies();

    function size() {
      const floor = lies();
      return floor ? [floor.width, floor.height] : [window.innerWidth, window.innerHeight];
    }

    function fit() {
      const floor = lies();
      const density = floor ? floor.density : Math.min(MOST_PIXELS_PER_POINT, window.devicePixelRatio || 1);
      const [across, down] = size();
      const [width, height] = [Math.round(across * density), Math.round(down * density)];
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      pen.setTransform(density, 0, 0, density, 0, 0);
      pen.clearRect(0, 0, across, down);
      pen.lineCap = pen.lineJoin = "round";
      if (floor) window.desirePath.headsetFloor.painted(canvas);
    }

    return {
      canvas,
      pen,
      fit,
      size,
      due: () => window.desirePath.headsetFloor.due(canvas),
      projector: () => lies()?.project ?? window.desirePath.viser.projector(),
      uncover(project) {
        if (!lies()) window.desirePath.bodies.uncover(pen, project); // on the floor bodies stand before it by themselves
      },
    };
  };
})();
