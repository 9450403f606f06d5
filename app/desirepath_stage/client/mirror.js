// @ts-check
/**
 * A real robot on the floor: where it is, what its lidar hit, where it would go, where people stand. The page tells it
 * as the robot does (`steer`, do: mirror); a press on the floor is told back (`floor`).
 */
(() => {
  "use strict";
  const { bridge, frames, viser, scheme } = window.desirePath;
  const STILL_PX = 8; // a press that moves farther turns the head
  const PERSON_M = 0.3;
  const { canvas, pen, fit, size, due, projector, uncover } = window.desirePath.overlay("desire-path-mirror");
  /** @type {MirrorOrder | null} */
  let now = null;
  let painted = "";
  /** Corners of what the map has. @type {number[][][]} */
  let walls = [];
  /** @type {{x: number, y: number} | null} */
  let press = null;

  /** @param {number[] | null} spot @param {number} radius px @param {string} fill */
  function dot(spot, radius, fill) {
    if (!spot) return;
    pen.fillStyle = fill;
    pen.beginPath();
    pen.arc(spot[0], spot[1], radius, 0, 2 * Math.PI);
    pen.fill();
  }

  /** @param {MirrorOrder} seen */
  function draw(seen) {
    const project = projector();
    const metre = (/** @type {number} */ x, /** @type {number} */ y) => {
      const [a, b] = [project(x, y), project(x, y + 1)];
      return a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 40;
    };
    pen.fillStyle = scheme.isDark() ? "rgb(150 144 134)" : "rgb(120 112 100)";
    for (const wall of walls) {
      const spots = wall.map(([x, y]) => project(x, y));
      if (!spots.every(Boolean)) continue;
      pen.beginPath();
      spots.forEach((spot, i) => spot && (i ? pen.lineTo(spot[0], spot[1]) : pen.moveTo(spot[0], spot[1])));
      pen.fill();
    }
    const plan = [seen.pose.slice(0, 2), ...seen.plan].map(([x, y]) => project(x, y));
    for (const [width, ink] of /** @type {[number, string][]} */ ([[10, scheme.colour("--paper")], [6, "rgb(47 106 61)"]])) {
      pen.lineWidth = width;
      pen.strokeStyle = ink;
      pen.beginPath();
      plan.forEach((spot, i) => spot && (i ? pen.lineTo(spot[0], spot[1]) : pen.moveTo(spot[0], spot[1])));
      if (seen.plan.length) pen.stroke();
    }
    for (const [x, y] of seen.scan) dot(project(x, y), 3.5, "rgb(176 58 46)");
    for (const [x, y] of seen.people) {
      const spot = project(x, y);
      dot(spot, PERSON_M * metre(x, y), "rgb(52 110 180 / 45%)");
      dot(spot, 4, "rgb(52 110 180)");
    }
    uncover(project);
  }

  function step() {
    if (!now) return;
    const project = viser.isUp() && due() ? projector() : null;
    const what = project ? JSON.stringify([size(), scheme.isDark(), now, project(0, 0), project(1, 1)]) : "";
    if (project && what !== painted) {
      painted = what;
      fit();
      draw(now);
    }
    frames.next(step);
  }

  addEventListener("pointerdown", (event) => {
    press = now && event.isPrimary ? { x: event.clientX, y: event.clientY } : null;
  });
  addEventListener("pointerup", (event) => {
    const still = press && Math.hypot(event.clientX - press.x, event.clientY - press.y) < STILL_PX;
    press = null;
    const place = still && now ? viser.floorAt(event.clientX, event.clientY) : null;
    if (place) bridge.post("floor", { place });
  });

  window.desirePath.mirror = {
    /** @param {MirrorOrder} order */
    show(order) {
      const first = !now;
      now = order;
      walls = order.walls ?? walls;
      window.desirePath.player.place(0, order.pose, true);
      window.desirePath.camera.fit(); // a slow machine's viewer may have put its own camera over the scene's
      if (first) {
        window.desirePath.sheet.element.prepend(canvas);
        frames.next(step);
      }
    },
    /** The floor was pressed by a hand with a headset. @param {number[]} place @returns {boolean} whether a robot is mirrored here */
    press(place) {
      if (now) bridge.post("floor", { place });
      return now !== null;
    },
    /** Another scene stands there. */
    stop() {
      now = null;
      walls = [];
      painted = "";
      canvas.remove();
    },
  };
})();
