// @ts-check
/** Where the robot is when it is out of the picture: an arrow at the edge that is nearest to it. */
(() => {
  "use strict";
  const EDGE_PX = 40;
  const INSIDE_PX = 6; // of the window: so much of the robot still is in it
  const HEIGHT_M = 0.25;

  const arrow = document.createElement("div");
  arrow.id = "desire-path-finder";
  arrow.setAttribute("aria-hidden", "true"); // who cannot see the picture does not look for the robot in it
  arrow.hidden = true;
  const head = document.createElement("i");
  arrow.append(head, document.createElement("b"));
  window.desirePath.sheet.element.append(arrow);

  window.desirePath.finder = {
    /** No robot is looked for. */
    rest() {
      arrow.hidden = true;
    },

    /** The robot is there. @param {number} x @param {number} y */
    look(x, y) {
      const { viser, sheet } = window.desirePath;
      const [width, height, above] = [window.innerWidth, window.innerHeight, sheet.covered()];
      const at = viser.projector()(x, y, HEIGHT_M);
      const inside = at && at[0] > -INSIDE_PX && at[0] < width + INSIDE_PX && at[1] > above - INSIDE_PX && at[1] < height + INSIDE_PX;
      arrow.hidden = Boolean(inside);
      if (inside) return;
      const middle = [width / 2, (height + above) / 2];
      // Behind the eyes the picture says nothing of up and down; there the shorter turn counts.
      const way = at ? [at[0] - middle[0], at[1] - middle[1]] : [window.desirePath.camera.isLeft(x, y) ? -1 : 1, 0];
      const [halfWide, halfHigh] = [width / 2 - EDGE_PX, (height - above) / 2 - EDGE_PX];
      const reach = Math.min(halfWide / Math.max(1e-9, Math.abs(way[0])), halfHigh / Math.max(1e-9, Math.abs(way[1])));
      arrow.style.transform = `translate(${middle[0] + reach * way[0]}px, ${middle[1] + reach * way[1]}px) translate(-50%, -50%)`;
      head.style.transform = `rotate(${Math.atan2(way[1], way[0])}rad)`;
    },
  };
})();
