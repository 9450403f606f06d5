// @ts-check
/** Canvases of our own over viser's picture, as large as the window. */
(() => {
  "use strict";
  const MOST_PIXELS_PER_POINT = 2;

  /** @param {string} id @returns {Overlay} */
  window.desirePath.overlay = (id) => {
    const canvas = document.createElement("canvas");
    canvas.id = id;
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));

    function fit() {
      const density = Math.min(MOST_PIXELS_PER_POINT, window.devicePixelRatio || 1);
      const [width, height] = [Math.round(window.innerWidth * density), Math.round(window.innerHeight * density)];
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      pen.setTransform(density, 0, 0, density, 0, 0);
      pen.clearRect(0, 0, window.innerWidth, window.innerHeight);
      pen.lineCap = pen.lineJoin = "round";
    }

    return { canvas, pen, fit };
  };
})();
