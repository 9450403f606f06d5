// @ts-check
/**
 * What stands in the room for who wears a headset, where the page around the stage cannot be seen: a panel with its words
 * and buttons, rays from the hands, the dark while a room is being built. Which buttons there are, and what pressing one
 * does, is the page's; entering and leaving is headset.js's.
 */
(() => {
  "use strict";
  const { viser, scheme } = window.desirePath;
  const [WIDE, HIGH, PX_PER_M] = [1024, 640, 800]; // of the panel's picture, pixels
  const AWAY_M = 1.7; // the panel from the eyes; at this distance eyes need not strain
  const [ABOVE_M, ABOVE_QUIET_M] = [0.2, 0.75]; // over eye height; higher while a robot drives, so that it covers none
  const ASIDE_RAD = 0.9; // who looks farther away from the panel, for so long, gets it there
  const ASIDE_MS = 700;
  const [RAY_M, RAY_WIDTH_M, GRIP_M, GRIP_WIDTH_M, DOT_M] = [1.3, 0.006, 0.12, 0.024, 0.026];
  const DARK_M = 0.3; // the dark, before the eyes
  // The arrow to a robot that is out of sight: from where on, whither and how far off it is shown, how large.
  const [UNSEEN_RAD, ARROW_RAD, ARROW_M, ARROW_SIZE_M] = [0.7, 0.42, 1.0, 0.09];
  const FONT = 'system-ui, "Segoe UI", "Noto Sans", sans-serif';

  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: WIDE, height: HIGH });
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** @type {RoomPanel} */
  let panel = { count: "", text: "", hint: "", buttons: [], quiet: false, progress: null };
  /** Where its buttons lie, pixels. @type {{button: RoomButton, x: number, y: number, w: number, h: number}[]} */
  let spots = [];
  /** @type {Record<string, any>} three.js meshes by what they are */
  let made = {};
  /** @type {{centre: number[], right: number[], toward: number[]} | null} where the panel stands */
  let stands = null;
  let yaw = 0;
  let asideSince = 0;
  /** What is pointed at, and how much of the time for a look is over, 0 to 1. @type {string[]} */
  let pointed = [];
  let dwelt = 0;

  const add = (/** @type {number[]} */ a, /** @type {number[]} */ b, by = 1) => a.map((value, i) => value + by * b[i]);
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (/** @type {number[]} */ a, /** @type {number[]} */ b) =>
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (/** @type {number[]} */ a) => a.map((value) => value / (Math.hypot(...a) || 1));

  /** A square of the scene's own kind, standing in the room. @param {any} square @param {number} order */
  function quad(square, order) {
    const mesh = new square.constructor(square.geometry.clone(), square.material.clone());
    Object.assign(mesh, { matrixAutoUpdate: false, frustumCulled: false, visible: false, renderOrder: order });
    Object.assign(mesh.material, { map: null, transparent: true, depthTest: false, depthWrite: false, side: 2 });
    viser.world().add(mesh);
    return mesh;
  }

  /** @param {any} mesh @param {number[]} at its middle @param {number[]} x @param {number[]} y edges, as long as they are */
  function put(mesh, at, x, y) {
    const z = unit(cross(x, y));
    mesh.matrix.set(x[0], y[0], z[0], at[0], x[1], y[1], z[1], at[1], x[2], y[2], z[2], at[2], 0, 0, 0, 1);
    mesh.visible = true;
  }

  /** @param {string} text @param {number} wide @returns {string[]} */
  function lines(text, wide) {
    /** @type {string[]} */
    const found = [];
    for (const paragraph of text.split("\n")) {
      let line = "";
      for (const word of paragraph.split(/\s+/)) {
        const longer = line ? `${line} ${word}` : word;
        if (line && pen.measureText(longer).width > wide) {
          found.push(line);
          line = word;
        } else line = longer;
      }
      found.push(line);
    }
    return found;
  }

  /** @param {RoomButton} button @param {number} x @param {number} y @param {number} w @param {number} h */
  function paintButton(button, x, y, w, h) {
    const on = pointed.includes(button.id) && !button.resting;
    pen.globalAlpha = button.resting ? 0.45 : 1;
    pen.beginPath();
    pen.roundRect(x, y, w, h, 16);
    pen.fillStyle = scheme.colour(button.main ? "--path" : "--around");
    pen.fill();
    if (on && dwelt > 0) {
      pen.save();
      pen.clip();
      pen.fillStyle = scheme.colour("--behind");
      pen.fillRect(x, y + h - 14, w * dwelt, 14);
      pen.restore();
    }
    pen.lineWidth = on ? 8 : 3;
    pen.strokeStyle = scheme.colour("--ink");
    pen.stroke();
    pen.fillStyle = scheme.colour(button.main ? "--on-path" : "--ink");
    pen.textAlign = "center";
    let size = button.letter ? 84 : button.tool ? 30 : 38;
    do pen.font = `600 ${(size -= 2)}px ${FONT}`;
    while (size > 20 && pen.measureText(button.text).width > w - 24);
    pen.fillText(button.text, x + w / 2, y + h / 2);
    pen.globalAlpha = 1;
    spots.push({ button, x, y, w, h });
  }

  /** Buttons side by side, the last row first. @param {RoomButton[]} buttons @param {number} bottom @param {number} h @param {number} most in a row */
  function paintRows(buttons, bottom, h, most) {
    const rows = Math.ceil(buttons.length / most);
    for (let row = 0; row < rows; row += 1) {
      const some = buttons.slice(row * most, (row + 1) * most);
      const w = (WIDE - 80 - 24 * (some.length - 1)) / some.length;
      const y = bottom - (rows - row) * (h + 16) + 16;
      some.forEach((button, i) => paintButton(button, 40 + i * (w + 24), y, w, h));
    }
    return bottom - rows * (h + 16);
  }

  function paint() {
    pen.clearRect(0, 0, WIDE, HIGH);
    spots = [];
    const high = panel.quiet ? 150 : HIGH;
    pen.beginPath();
    pen.roundRect(3, 3, WIDE - 6, high - 6, 28);
    pen.fillStyle = scheme.colour("--paper");
    pen.fill();
    pen.textBaseline = "middle";
    let bottom = high - 30;
    if (!panel.quiet) {
      const tools = panel.buttons.filter(({ tool }) => tool);
      const others = panel.buttons.filter(({ tool }) => !tool);
      if (tools.length) bottom = paintRows(tools, bottom, 60, 3) - 8;
      const letters = others.filter(({ letter }) => letter);
      if (letters.length) bottom = paintRows(letters, bottom, 130, 2);
      const rest = others.filter(({ letter }) => !letter);
      if (rest.length) bottom = paintRows(rest, bottom, 84, rest.length > 4 ? 3 : 2);
    }
    pen.textAlign = "left";
    let y = 46;
    if (panel.count && !panel.quiet) {
      pen.fillStyle = scheme.colour("--soft");
      pen.font = `28px ${FONT}`;
      pen.fillText(panel.count, 44, y);
      y += 52;
    }
    for (const [text, role, most, weight] of [[panel.text, "--ink", 46, 600], [panel.hint, "--soft", 34, 400]]) {
      if (!text || (panel.quiet && role === "--soft")) continue;
      let size = Number(most);
      /** @type {string[]} */
      let shown;
      do {
        pen.font = `${weight} ${size}px ${FONT}`;
        shown = lines(String(text), WIDE - 88);
        size -= 2;
      } while (size > 20 && y + shown.length * size * 1.35 > bottom);
      pen.fillStyle = scheme.colour(String(role));
      for (const line of shown) {
        pen.fillText(line, 44, y + size / 2);
        y += size * 1.35;
      }
      y += 14;
    }
    if (panel.progress !== null) {
      const at = panel.quiet ? high - 38 : bottom - 20;
      pen.fillStyle = scheme.colour("--behind");
      pen.fillRect(44, at, WIDE - 88, 12);
      pen.fillStyle = scheme.colour("--path");
      pen.fillRect(44, at, (WIDE - 88) * panel.progress, 12);
    }
    if (made.panel) made.panel.material.map.needsUpdate = true;
  }

  /** @param {number[]} eye @param {number} facing where the eyes look, radians */
  function stand(eye, facing) {
    yaw = facing;
    const ahead = [Math.cos(yaw), Math.sin(yaw), 0];
    const up = panel.quiet ? ABOVE_QUIET_M : ABOVE_M;
    const lean = unit([-ahead[0], -ahead[1], -up / AWAY_M]); // faces the eyes
    const right = [ahead[1], -ahead[0], 0];
    stands = { centre: add(add(eye, ahead, AWAY_M), [0, 0, up]), right, toward: lean };
    if (made.panel) put(made.panel, stands.centre, right.map((v) => (v * WIDE) / PX_PER_M), cross(lean, right).map((v) => (v * HIGH) / PX_PER_M));
  }

  window.desirePath.headsetRoom = {
    /** Makes what it needs of a square that the scene brings along. @returns {boolean} whether it could */
    build(/** @type {string} */ name) {
      const [square] = viser.meshes(name);
      if (!square) return false;
      const Texture = square.material.map.constructor;
      made = { dark: quad(square, 990), panel: quad(square, 992), rays: [] };
      for (let i = 0; i < 2; i += 1) made.rays.push([quad(square, 994), quad(square, 995), quad(square, 996)]);
      made.panel.material.map = Object.assign(new Texture(canvas), { flipY: false, generateMipmaps: false, minFilter: 1006 });
      made.dark.material.color.setScalar(0.03);
      for (const [ray, grip, spot] of made.rays) {
        ray.material.color.setRGB(0.11, 0.41, 0.24);
        grip.material.color.setScalar(0.2);
        spot.material.color.setRGB(0.75, 0.13, 0.09);
      }
      made.arrow = quad(square, 991);
      const corners = made.arrow.geometry.attributes.position;
      for (let i = 0; i < corners.count; i += 1) if (corners.getX(i) > 0) corners.setY(i, 0); // a square's, now an arrow's
      made.arrow.material.color.setRGB(0.11, 0.41, 0.24);
      stands = null;
      paint();
      return true;
    },

    /** Takes all of it away. */
    clear() {
      for (const mesh of Object.values(made).flat(2)) {
        mesh.parent?.remove(mesh);
        mesh.geometry.dispose();
        mesh.material.map?.dispose();
        mesh.material.dispose();
      }
      made = {};
      stands = null;
    },

    /** @param {RoomPanel} next what the panel says from now on */
    show(next) {
      const moved = next.quiet !== panel.quiet;
      panel = next;
      if (moved) stands = null;
      paint();
    },

    /** What the panel says. */
    shown: () => panel,
    /** Which buttons are pointed at. */
    pointed: () => pointed,
    /** Whether a button stands there and counts. @param {string} id */
    may: (id) => spots.some(({ button }) => button.id === id && !button.resting),

    /**
     * One picture. @param {number[]} eye m @param {number[]} along where it looks
     * @param {RoomRay[]} rays of hands, or of the eyes where there are none
     * @param {number} dark 0 to 1 @returns {string[]} the buttons that rays point at and that count
     */
    draw(eye, along, rays, dark) {
      const facing = Math.atan2(along[1], along[0]);
      const aside = Math.abs(Math.atan2(Math.sin(facing - yaw), Math.cos(facing - yaw)));
      const now = performance.now();
      if (aside < ASIDE_RAD) asideSince = now;
      if (!stands || now - asideSince > ASIDE_MS) stand(eye, facing);
      /** @type {string[]} */
      const found = [];
      made.rays.forEach((/** @type {any[]} */ [ray, grip, spot], /** @type {number} */ i) => {
        ray.visible = grip.visible = spot.visible = false;
        if (!rays[i]) return;
        const { from, along: way, held } = rays[i];
        const hit = this.meet(from, way);
        const far = hit ? hit.metres : RAY_M;
        const side = unit(cross(way, add(eye, from, -1)));
        if (held) {
          put(ray, add(from, way, far / 2), side.map((v) => v * RAY_WIDTH_M), way.map((v) => v * far));
          put(grip, add(from, way, -GRIP_M / 2), side.map((v) => v * GRIP_WIDTH_M), way.map((v) => v * GRIP_M));
        }
        if (!hit || !stands) return;
        put(spot, add(add(from, way, far), stands.toward, 0.004), stands.right.map((v) => v * DOT_M), [0, 0, DOT_M]);
        if (hit.button && !hit.button.resting) found.push(hit.button.id);
      });
      const up = cross(cross(along, [0, 0, 1]), along);
      put(made.dark, add(eye, along, DARK_M), unit(cross(along, up)).map((v) => v * 6), unit(up).map((v) => v * 6));
      made.dark.visible = dark > 0;
      made.dark.material.opacity = dark;
      return found;
    },

    /** An arrow at the edge of sight, on the side of the shorter turn to a robot out of it. @param {number[]} eye @param {number[]} along @param {number[]} robot x, y */
    find(eye, along, robot) {
      const facing = Math.atan2(along[1], along[0]);
      const turn = Math.atan2(robot[1] - eye[1], robot[0] - eye[0]) - facing;
      const left = Math.atan2(Math.sin(turn), Math.cos(turn));
      made.arrow.visible = false;
      if (!(Math.abs(left) > UNSEEN_RAD)) return;
      const side = Math.sign(left);
      const at = facing + side * ARROW_RAD;
      const way = [-Math.sin(at) * side * ARROW_SIZE_M, Math.cos(at) * side * ARROW_SIZE_M, 0];
      put(made.arrow, add(eye, [Math.cos(at), Math.sin(at), -0.12], ARROW_M), way, [0, 0, ARROW_SIZE_M]);
    },

    /** Which way the arrow points: 1 left, -1 right, 0 none. */
    found() {
      if (!made.arrow?.visible) return 0;
      const [eye, arrow] = [viser.fromView(viser.drawing().gl.xr.getCamera().position.toArray()), made.arrow.matrix.elements];
      const [x, y] = [arrow[12] - eye[0], arrow[13] - eye[1]];
      return Math.sign(x * arrow[1] - y * arrow[0]);
    },

    /** Where a ray meets the panel. @param {number[]} from @param {number[]} along */
    meet(from, along) {
      if (!stands) return null;
      const slope = dot(along, stands.toward);
      if (Math.abs(slope) < 1e-6) return null;
      const metres = dot(add(stands.centre, from, -1), stands.toward) / slope;
      if (metres <= 0) return null;
      const off = add(add(from, along, metres), stands.centre, -1);
      const x = WIDE / 2 + dot(off, stands.right) * PX_PER_M;
      const y = HIGH / 2 - dot(off, cross(stands.toward, stands.right)) * PX_PER_M;
      if (x < 0 || y < 0 || x > WIDE || y > (panel.quiet ? 150 : HIGH)) return null;
      const on = spots.find((spot) => x >= spot.x && x <= spot.x + spot.w && y >= spot.y && y <= spot.y + spot.h);
      return { metres, button: on?.button ?? null };
    },

    /** Where the middle of a button is, m; for tests and for who points by keys. @param {string} id */
    place(id) {
      const spot = spots.find(({ button }) => button.id === id);
      if (!spot || !stands) return null;
      const [x, y] = [spot.x + spot.w / 2 - WIDE / 2, HIGH / 2 - spot.y - spot.h / 2];
      return add(add(stands.centre, stands.right, x / PX_PER_M), cross(stands.toward, stands.right), y / PX_PER_M);
    },

    /** @param {string[]} ids of what is pointed at @param {number} share of the time for a look, 0 to 1 */
    point(ids, share) {
      const shown = Math.round(share * 20) / 20;
      if (ids.join() === pointed.join() && shown === dwelt) return;
      [pointed, dwelt] = [ids, shown];
      paint();
    },
  };
})();
