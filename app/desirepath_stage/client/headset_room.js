// @ts-check
/**
 * What stands in the room for who wears a headset, where the page around the stage cannot be seen: a panel with its words
 * and buttons, rays from the hands, the dark while a room is being built. Which buttons there are, and what pressing one
 * does, is the page's; entering and leaving is headset.js's.
 */
(() => {
  "use strict";
  const { viser, scheme, quads } = window.desirePath;
  const { add, dot, cross, unit, put } = quads;
  const [WIDE, MOST_HIGH, PX_PER_M] = [1024, 1120, 800]; // of the panel's picture, pixels
  const [HIGH, QUIET_HIGH, BESIDE_ROWS] = [640, 150, 520]; // of what is painted on it: mostly, quiet, beside sliders
  const [SLIDER, POINTS, ENDS] = [70, 72, 32]; // how high a row is, and what its ends are called, pixels
  const AWAY_M = 1.7; // the panel from the eyes; at this distance eyes need not strain
  const [ABOVE_M, ABOVE_QUIET_M] = [0.6, 1.15]; // its top over eye height; higher while a robot drives, so that it covers none
  const BESIDE_RAD = 0.62; // a panel of sliders stands to the left of what they change
  const ASIDE_RAD = 0.9; // who looks farther away from the panel, for so long, gets it there
  const ASIDE_MS = 700;
  const [RAY_M, RAY_WIDTH_M, GRIP_M, GRIP_WIDTH_M, DOT_M] = [1.3, 0.006, 0.12, 0.024, 0.026];
  const DARK_M = 0.3; // the dark, before the eyes
  const [NARROW_M, NARROW_SIZE_M] = [0.29, 3]; // what narrows the sight while one is moved
  const LABEL = { px: [320, 72], metres: 0.34, above: 0.14 };
  // The arrow to a robot that is out of sight: from where on, whither and how far off it is shown, how large.
  const [UNSEEN_RAD, ARROW_RAD, ARROW_M, ARROW_SIZE_M] = [0.7, 0.42, 1.0, 0.09];
  const FONT = 'system-ui, "Segoe UI", "Noto Sans", sans-serif';

  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: WIDE, height: MOST_HIGH });
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  /** @type {RoomPanel} */
  let panel = { count: "", text: "", hint: "", buttons: [], rows: [], quiet: false, beside: false, progress: null };
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
  /** How high what is painted is, pixels. */
  let high = HIGH;
  /** Names that stand over things. @type {{mesh: any, canvas: HTMLCanvasElement, said: string}[]} */
  let names = [];
  let narrowed = 0;
  /** What colours mean on the floor. @type {{name: string, colour: number[], hollow?: boolean}[]} */
  let colours = [];

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
    const strong = button.main || button.pressed;
    pen.fillStyle = scheme.colour(strong ? "--path" : "--around");
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
    pen.fillStyle = scheme.colour(strong ? "--on-path" : "--ink");
    pen.textAlign = "center";
    let size = button.letter ? 84 : button.tool ? 30 : 38;
    do pen.font = `600 ${(size -= 2)}px ${FONT}`;
    while (size > 20 && pen.measureText(button.text).width > w - 24);
    pen.fillText(button.text, x + w / 2, y + h / 2, w - 16);
    pen.globalAlpha = 1;
    spots.push({ button, x, y, w, h });
  }

  /** @param {RoomRow} row @param {number} y */
  function paintSlider(row, y) {
    const [less, set, more] = row.buttons;
    paintButton(less, 40, y, 84, SLIDER - 12);
    paintButton(more, WIDE - 124, y, 84, SLIDER - 12);
    const [x, w] = [156, WIDE - 312];
    pen.fillStyle = scheme.colour("--ink");
    pen.textAlign = "left";
    let size = 28;
    do pen.font = `500 ${(size -= 2)}px ${FONT}`;
    while (size > 16 && pen.measureText(row.text).width > w);
    pen.fillText(row.text, x, y + 14);
    pen.fillStyle = scheme.colour("--behind");
    pen.fillRect(x, y + 36, w, 12);
    pen.beginPath();
    pen.arc(x + w * (row.share ?? 0), y + 42, pointed.includes(set.id) ? 18 : 14, 0, 2 * Math.PI);
    pen.fillStyle = scheme.colour("--path");
    pen.fill();
    spots.push({ button: set, x, y: y + 24, w, h: SLIDER - 30 });
  }

  /** @param {RoomRow} row @param {number} y */
  function paintPoints({ buttons, ends }, y) {
    const gap = buttons.length > 7 ? 10 : 20;
    const w = (WIDE - 80 - gap * (buttons.length - 1)) / buttons.length;
    buttons.forEach((button, i) => paintButton(button, 40 + i * (w + gap), y, w, POINTS - 12));
    if (!ends) return;
    pen.fillStyle = scheme.colour("--soft");
    pen.font = `24px ${FONT}`;
    ends.forEach((end, i) => {
      pen.textAlign = i ? "right" : "left";
      pen.fillText(end, i ? WIDE - 44 : 44, y + POINTS + 4, (WIDE - 120) / 2);
    });
  }

  /** From the right, in the line of the count. */
  function paintColours() {
    if (panel.quiet) return;
    let right = WIDE - 44;
    pen.font = `600 26px ${FONT}`;
    pen.textAlign = "right";
    for (const { name, colour, hollow } of [...colours].reverse()) {
      pen.fillStyle = scheme.colour("--ink");
      pen.fillText(name, right, 46);
      right -= pen.measureText(name).width + 24;
      pen.beginPath();
      pen.arc(right, 46, 11, 0, 2 * Math.PI);
      [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [`rgb(${colour.join(" ")})`, `rgb(${colour.join(" ")})`, 5];
      if (hollow) pen.stroke();
      else pen.fill();
      right -= 32;
    }
  }

  const highOf = (/** @type {RoomRow} */ row) => (row.share !== null ? SLIDER : POINTS + (row.ends ? ENDS : 0));

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
    pen.clearRect(0, 0, WIDE, MOST_HIGH);
    spots = [];
    const rowsHigh = panel.rows.reduce((sum, row) => sum + highOf(row), 0);
    high = panel.quiet ? QUIET_HIGH : Math.min(MOST_HIGH, Math.max(HIGH, rowsHigh && BESIDE_ROWS + rowsHigh));
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
      if (rest.length) bottom = paintRows(rest, bottom, rowsHigh || rest.length > 6 ? 64 : 84, rest.length > 4 ? 3 : 2);
      for (const row of [...panel.rows].reverse()) {
        bottom -= highOf(row);
        if (row.share !== null) paintSlider(row, bottom);
        else paintPoints(row, bottom);
      }
    }
    paintColours();
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

  /** Dark all around, and nothing in the middle. */
  function hole() {
    const round = Object.assign(document.createElement("canvas"), { width: 256, height: 256 });
    const ink = /** @type {CanvasRenderingContext2D} */ (round.getContext("2d"));
    const shade = ink.createRadialGradient(128, 128, 14, 128, 128, 30); // 19 and 38 degrees off the middle
    shade.addColorStop(0, "rgb(8 8 8 / 0)");
    shade.addColorStop(1, "rgb(8 8 8 / 1)");
    ink.fillStyle = shade;
    ink.fillRect(0, 0, 256, 256);
    return round;
  }

  /** @param {HTMLCanvasElement} on @param {string} text @param {boolean} meant */
  function paintName(on, text, meant) {
    const ink = /** @type {CanvasRenderingContext2D} */ (on.getContext("2d"));
    ink.clearRect(0, 0, on.width, on.height);
    let size = 42;
    do ink.font = `600 ${(size -= 2)}px ${FONT}`;
    while (size > 20 && ink.measureText(text).width > on.width - 40);
    const wide = Math.min(on.width, ink.measureText(text).width + 36);
    ink.beginPath();
    ink.roundRect((on.width - wide) / 2 + 2, 2, wide - 4, on.height - 4, 16);
    ink.fillStyle = scheme.colour(meant ? "--path" : "--paper");
    ink.fill();
    ink.lineWidth = 4;
    ink.strokeStyle = scheme.colour("--ink");
    ink.stroke();
    ink.fillStyle = scheme.colour(meant ? "--on-path" : "--ink");
    [ink.textAlign, ink.textBaseline] = ["center", "middle"];
    ink.fillText(text, on.width / 2, on.height / 2);
  }

  /** @param {number[]} eye @param {number} facing where the eyes look, radians */
  function stand(eye, facing) {
    yaw = facing;
    const toward = panel.beside ? yaw + BESIDE_RAD : yaw;
    const ahead = [Math.cos(toward), Math.sin(toward), 0];
    const up = (panel.quiet ? ABOVE_QUIET_M : ABOVE_M) - MOST_HIGH / PX_PER_M / 2;
    const lean = unit([-ahead[0], -ahead[1], -up / AWAY_M]); // faces the eyes
    const right = [ahead[1], -ahead[0], 0];
    stands = { centre: add(add(eye, ahead, AWAY_M), [0, 0, up]), right, toward: lean };
    if (made.panel) put(made.panel, stands.centre, right.map((v) => (v * WIDE) / PX_PER_M), cross(lean, right).map((v) => (v * MOST_HIGH) / PX_PER_M));
  }

  window.desirePath.headsetRoom = {
    /** Makes what it needs of a square that the scene brings along. @returns {boolean} whether it could */
    build(/** @type {string} */ name) {
      if (!quads.use(name)) return false;
      made = { dark: quads.make(990), narrow: quads.make(989), panel: quads.make(992), rays: [] };
      for (let i = 0; i < 2; i += 1) made.rays.push([quads.make(994), quads.make(995), quads.make(996)]);
      quads.picture(made.panel, canvas);
      quads.picture(made.narrow, hole());
      made.dark.material.color.setScalar(0.03);
      for (const [ray, grip, spot] of made.rays) {
        ray.material.color.setRGB(0.11, 0.41, 0.24);
        grip.material.color.setScalar(0.2);
        spot.material.color.setRGB(0.75, 0.13, 0.09);
      }
      made.arrow = quads.make(991);
      const corners = made.arrow.geometry.attributes.position;
      for (let i = 0; i < corners.count; i += 1) if (corners.getX(i) > 0) corners.setY(i, 0); // a square's, now an arrow's
      made.arrow.material.color.setRGB(0.11, 0.41, 0.24);
      stands = null;
      paint();
      return true;
    },

    /** Takes all of it away. */
    clear() {
      for (const mesh of [...Object.values(made).flat(2), ...names.map((one) => one.mesh)]) quads.drop(mesh);
      [made, names, narrowed] = [{}, [], 0];
      stands = null;
    },

    /** @param {RoomPanel} next what the panel says from now on */
    show(next) {
      const moved = next.quiet !== panel.quiet || next.beside !== panel.beside;
      panel = next;
      if (moved) stands = null;
      paint();
    },

    /** @param {{name: string, colour: number[], hollow?: boolean}[]} entries what colours mean on the floor */
    legend(entries) {
      colours = entries;
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
        const { floor } = rays[i];
        const down = floor && Math.hypot(floor[0] - from[0], floor[1] - from[1], from[2]);
        const far = hit ? hit.metres : down || RAY_M;
        const side = unit(cross(way, add(eye, from, -1)));
        if (held) {
          put(ray, add(from, way, far / 2), side.map((v) => v * RAY_WIDTH_M), way.map((v) => v * far));
          put(grip, add(from, way, -GRIP_M / 2), side.map((v) => v * GRIP_WIDTH_M), way.map((v) => v * GRIP_M));
        }
        if (!hit && floor) put(spot, [floor[0], floor[1], 0.03], [2 * DOT_M, 0, 0], [0, 2 * DOT_M, 0]);
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

    /** What is seen narrows while one is moved by other than the own feet. @param {number[]} eye @param {number[]} along @param {number} share 0 to 1 */
    narrow(eye, along, share) {
      narrowed = share;
      const up = cross(cross(along, [0, 0, 1]), along);
      put(made.narrow, add(eye, along, NARROW_M), unit(cross(along, up)).map((v) => v * NARROW_SIZE_M), unit(up).map((v) => v * NARROW_SIZE_M));
      made.narrow.visible = share > 0;
      made.narrow.material.opacity = share;
    },
    /** How dark it is all around, 0 to 1. */
    darkness: () => (made.dark?.visible ? made.dark.material.opacity : 0),
    /** How far it is narrowed, 0 to 1. */
    narrowed: () => narrowed,

    /** Names over things, turned to the eyes. @param {number[]} eye @param {{at: number[], text: string, on: boolean}[]} labels */
    label(eye, labels) {
      for (const one of names.splice(labels.length)) quads.drop(one.mesh);
      labels.forEach(({ at, text, on }, i) => {
        if (!names[i]) {
          const canvas = Object.assign(document.createElement("canvas"), { width: LABEL.px[0], height: LABEL.px[1] });
          const mesh = quads.make(985);
          quads.picture(mesh, canvas);
          names.push({ mesh, canvas, said: "" });
        }
        const { mesh, canvas, said } = names[i];
        const now = JSON.stringify([text, on, scheme.isDark()]);
        if (now !== said) {
          names[i].said = now;
          paintName(canvas, text, on);
          mesh.material.map.needsUpdate = true;
        }
        const away = [eye[0] - at[0], eye[1] - at[1]];
        const far = Math.hypot(away[0], away[1]) || 1;
        const size = LABEL.metres * Math.max(1, far / 2.5); // as large wherever it stands
        const right = [-away[1] / far, away[0] / far, 0];
        put(mesh, add(at, [0, 0, LABEL.above * Math.max(1, far / 2.5)]), right.map((v) => v * size), [0, 0, (size * LABEL.px[1]) / LABEL.px[0]]);
      });
    },
    /** What they say. */
    labels: () => names.map(({ said }) => JSON.parse(said)[0]),

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
      const y = MOST_HIGH / 2 - dot(off, cross(stands.toward, stands.right)) * PX_PER_M;
      if (x < 0 || y < 0 || x > WIDE || y > high) return null;
      const on = spots.find((spot) => x >= spot.x && x <= spot.x + spot.w && y >= spot.y && y <= spot.y + spot.h);
      return { metres, button: on?.button ?? null, share: on ? (x - on.x) / on.w : 0 };
    },

    /** Where the middle of a button is, m; for tests and for who points by keys. @param {string} id */
    place(id) {
      const spot = spots.find(({ button }) => button.id === id);
      if (!spot || !stands) return null;
      const [x, y] = [spot.x + spot.w / 2 - WIDE / 2, MOST_HIGH / 2 - spot.y - spot.h / 2];
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
