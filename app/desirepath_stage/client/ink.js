// @ts-check
/**
 * What drawing looks like: the stroke in the colours of its speed, tight places, the ring to begin at, the legend.
 *
 * A canvas of our own over viser's picture; floor points are projected with the camera of this very frame, so that
 * nothing has to travel to the server and back. What the pen does is decided in draw.js.
 */
(() => {
  "use strict";
  const STROKE_M = 0.075; // as wide as a hand's chalk line seen from above
  const SLOW = [64, 44, 140];
  const MIDDLE = [30, 140, 140];
  const FAST = [250, 200, 40];
  const WOOD = { light: [216, 188, 154], dark: [91, 79, 65] }; // a see-through stroke would show where its pieces overlap
  const RED = "--wrong";
  const AMBER = "--tight";
  const GREEN = "--path";
  const INK = "--ink";
  const PAPER = "--paper";
  const { scheme } = window.desirePath;

  /**
   * @typedef {object} Picture what is to be seen
   * @property {number[][]} points of the stroke, metres
   * @property {number[]} speeds m/s, one per point
   * @property {boolean} faded the robot drives, the stroke steps back
   * @property {TightStretch[]} tight stretches
   * @property {{at: number[], text: string} | null} problem what the server found
   * @property {number[]} begin where the next section begins
   * @property {boolean} onward it goes on from what is there
   * @property {boolean} waiting for the pen to be put down there
   * @property {number[]} goal x, y, radius
   * @property {number[][][]} kept paths of this situation
   * @property {{at: number[], near: NearThing, tight: boolean} | null} pen where it is now, and whether the room there is tight
   * @property {boolean} cursor the pen is moved by keys
   * @property {number[][] | null} walk of the person, rows of t, x, y, yaw
   */

  const { canvas, pen, fit, size, due, projector, uncover } = window.desirePath.overlay("desire-path-ink");
  const legend = document.createElement("div");
  legend.id = "desire-path-speeds";
  const scale = document.createElement("i");
  const marker = document.createElement("b");
  const [slow, fast] = [document.createElement("span"), document.createElement("span")];
  scale.append(marker);
  legend.append(slow, scale, fast);
  scale.style.background = `linear-gradient(to right, rgb(${SLOW}), rgb(${MIDDLE}), rgb(${FAST}))`;

  /** @type {Record<string, any>} */
  let words = {};
  let [slowest, fastest] = [0, 1];
  let began = 0;
  const still = matchMedia("(prefers-reduced-motion: reduce)");

  /** @param {number} speed m/s */
  function share(speed) {
    return Math.max(0, Math.min(1, (speed - slowest) / (fastest - slowest)));
  }

  /** @param {number} speed m/s @param {boolean} faded nearer to the floor's colour @returns {string} */
  function colour(speed, faded) {
    const u = 2 * share(speed);
    const [from, to] = u < 1 ? [SLOW, MIDDLE] : [MIDDLE, FAST];
    const full = from.map((value, i) => value + (to[i] - value) * (u < 1 ? u : u - 1));
    const wood = scheme.isDark() ? WOOD.dark : WOOD.light;
    return `rgb(${full.map((value, i) => Math.round(faded ? 0.5 * (value + wood[i]) : value))})`;
  }

  /** A text of the page's catalogue. @param {string} key @param {Record<string, string>} [values] */
  function say(key, values = {}) {
    const found = key.split(".").reduce((/** @type {any} */ at, part) => at?.[part], words);
    return String(found ?? "").replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
  }

  /** @param {number} value @param {number} digits */
  const number = (value, digits) =>
    value.toLocaleString(words.language ?? "en", { minimumFractionDigits: digits, maximumFractionDigits: digits });

  /** How many pixels a metre is at that place. @param {Projector} project @param {number} x @param {number} y */
  function pixelsPerMetre(project, x, y) {
    const [a, b, c] = [project(x, y), project(x + 0.1, y), project(x, y + 0.1)];
    if (!a || !b || !c) return 60;
    return 10 * Math.sqrt((Math.hypot(b[0] - a[0], b[1] - a[1]) ** 2 + Math.hypot(c[0] - a[0], c[1] - a[1]) ** 2) / 2);
  }

  /** @param {Projector} project @param {number} x @param {number} y @param {number} radius metres */
  function circle(project, x, y, radius) {
    pen.beginPath();
    for (let k = 0; k <= 40; k += 1) {
      const at = project(x + radius * Math.cos((k * Math.PI) / 20), y + radius * Math.sin((k * Math.PI) / 20));
      if (at) pen.lineTo(at[0], at[1]);
    }
  }

  /** @param {(number[] | null)[]} spots pixels @param {number} from @param {number} to */
  function trace(spots, from, to) {
    pen.beginPath();
    let down = false;
    for (let i = from; i <= to; i += 1) {
      const at = spots[i];
      if (!at) down = false;
      else if (down) pen.lineTo(at[0], at[1]);
      else {
        pen.moveTo(at[0], at[1]);
        down = true;
      }
    }
  }

  /** @param {Projector} project @param {Picture} picture */
  function stroke(project, { points, speeds, faded, tight }) {
    const spots = points.map(([x, y]) => project(x, y));
    const last = points.length - 1;
    const wide = points.map(([x, y]) => Math.max(3, STROKE_M * pixelsPerMetre(project, x, y)));
    if (!faded) {
      pen.strokeStyle = "rgb(255 255 255 / 0.55)"; // the glow
      for (let i = 0; i < last; i += 4) {
        pen.lineWidth = wide[i] + 7;
        trace(spots, i, Math.min(last, i + 4));
        pen.stroke();
      }
    }
    for (let i = 0; i < last; i += 1) {
      pen.lineWidth = faded ? wide[i] / 2 : wide[i];
      pen.strokeStyle = colour(speeds[i], faded);
      trace(spots, i, i + 1);
      pen.stroke();
    }
    if (!faded) for (const place of tight) hatch(spots, wide, place);
  }

  /** Bars across a stretch that is too tight. @param {(number[] | null)[]} spots @param {number[]} wide @param {any} place */
  function hatch(spots, wide, place) {
    pen.strokeStyle = scheme.colour(place.near.metres < 0 ? RED : AMBER);
    pen.lineWidth = 2.5;
    const size = 7 + wide[place.worst] / 2;
    let since = Infinity;
    for (let i = place.from; i <= place.to; i += 1) {
      const [at, before] = [spots[i], spots[Math.max(0, i - 1)]];
      if (!at || !before) continue;
      since += Math.hypot(at[0] - before[0], at[1] - before[1]);
      if (since < 6) continue;
      since = 0;
      pen.beginPath();
      pen.moveTo(at[0] - size * 0.7, at[1] + size * 0.7);
      pen.lineTo(at[0] + size * 0.7, at[1] - size * 0.7);
      pen.stroke();
    }
  }

  /** Words on a small card beside a place, kept inside the window. @param {number[] | null} at @param {string} text @param {string} tone */
  function note(at, text, tone) {
    if (!at || !text) return;
    pen.font = "600 15px system-ui, 'Segoe UI', 'Noto Sans', sans-serif";
    const width = pen.measureText(text).width + 24;
    const [across, down] = size();
    const x = Math.max(8, Math.min(across - width - 8, at[0] + 18));
    const y = Math.max(8, Math.min(down - 40, at[1] - 42));
    pen.fillStyle = scheme.colour(PAPER);
    pen.strokeStyle = scheme.colour(tone);
    pen.lineWidth = 2;
    pen.beginPath();
    pen.roundRect(x, y, width, 30, 6);
    pen.fill();
    pen.stroke();
    pen.fillStyle = scheme.colour(INK);
    pen.textBaseline = "middle";
    pen.fillText(text, x + 12, y + 16);
  }

  /** @param {Projector} project @param {Picture} picture */
  function ring(project, { begin, waiting, onward }) {
    const [x, y] = begin;
    const phase = still.matches ? 0.5 : ((performance.now() - began) / 1600) % 1;
    for (const [radius, alpha] of [[0.3, 1], ...(waiting ? [[0.3 + 0.22 * phase, 1 - phase]] : [])]) {
      circle(project, x, y, radius);
      pen.globalAlpha = alpha;
      pen.strokeStyle = scheme.colour(PAPER);
      pen.lineWidth = 6;
      pen.stroke();
      pen.strokeStyle = scheme.colour(GREEN);
      pen.lineWidth = 3;
      pen.stroke();
    }
    pen.globalAlpha = 1;
    if (waiting) note(project(x, y), say(onward ? "go_on_here" : "begin_here"), GREEN);
  }

  /** Where the goal is out of sight: on which side it lies. @param {Projector} project @param {number[]} goal */
  function towards(project, [x, y]) {
    const at = project(x, y);
    const [across, down] = size();
    if (at && at[0] > 0 && at[0] < across) return;
    const left = window.desirePath.camera.isLeft(x, y);
    const [edge, way] = left ? [14, 1] : [across - 14, -1];
    const middle = down / 2;
    pen.fillStyle = scheme.colour(GREEN);
    pen.strokeStyle = scheme.colour(PAPER);
    pen.lineWidth = 3;
    pen.beginPath();
    pen.moveTo(edge, middle);
    pen.lineTo(edge + 22 * way, middle - 18);
    pen.lineTo(edge + 22 * way, middle + 18);
    pen.closePath();
    pen.stroke();
    pen.fill();
    note([left ? edge : edge - 12, middle + 82], say("goal"), GREEN);
  }

  /** The person's way as footprints, left and right in turn, each 0.3 m after the other. @param {Projector} project @param {number[][]} track */
  function footprints(project, track) {
    pen.fillStyle = scheme.colour("--feet");
    let [since, left] = [Infinity, false];
    track.forEach(([, x, y, yaw], i) => {
      since += i ? Math.hypot(x - track[i - 1][1], y - track[i - 1][2]) : 0;
      if (since < 0.3) return;
      [since, left] = [0, !left];
      const aside = left ? 0.09 : -0.09;
      const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
      pen.beginPath();
      for (let k = 0; k < 14; k += 1) {
        const [along, across] = [0.11 * Math.cos((k * Math.PI) / 7), aside + 0.045 * Math.sin((k * Math.PI) / 7)];
        const at = project(x + c * along - s * across, y + s * along + c * across);
        if (at) pen.lineTo(at[0], at[1]);
      }
      pen.closePath();
      pen.fill();
    });
  }

  /** How far it is to the nearest thing. @param {Projector} project @param {NonNullable<Picture["pen"]>} where */
  function room(project, { at, near, tight }) {
    const [here, there] = [project(at[0], at[1]), project(near.at[0], near.at[1])];
    if (!here || !there || near.metres > 1.5) return;
    pen.setLineDash([2, 5]);
    pen.strokeStyle = scheme.colour(INK);
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(here[0], here[1]);
    pen.lineTo(there[0], there[1]);
    pen.stroke();
    pen.setLineDash([]);
    const tone = near.metres < 0 ? RED : tight ? AMBER : INK;
    const kind = tone === RED ? "would_hit" : tone === AMBER ? "too_close" : "room_left";
    note(here, say(`${kind}.${near.name}`, { metres: number(near.metres, 2) }), tone);
  }

  window.desirePath.ink = {
    say,
    number,
    /** @param {Record<string, any>} given the page's words for the stage */
    use(given) {
      words = given;
      this.speeds(slowest, fastest);
    },
    /** @param {number} low @param {number} high m/s */
    speeds(low, high) {
      [slowest, fastest] = [low, high];
      slow.textContent = say("slow", { speed: number(low, 2) });
      fast.textContent = say("fast", { speed: number(high, 2) });
    },
    /** @param {number} speed of the pen now, m/s */
    speed(speed) {
      marker.style.left = `${100 * share(speed)}%`;
    },
    /** @param {boolean} shown */
    show(shown) {
      if (shown) {
        window.desirePath.sheet.element.prepend(canvas);
        window.desirePath.sheet.strip.append(legend);
      }
      else for (const one of [canvas, legend]) one.remove();
      began = performance.now();
    },
    /** @param {Picture} picture */
    paint(picture) {
      if (!due()) return;
      fit();
      const project = projector();
      for (const path of picture.kept) {
        const spots = path.map(([x, y]) => project(x, y));
        pen.strokeStyle = scheme.colour(GREEN);
        pen.globalAlpha = 0.45;
        pen.lineWidth = 3;
        trace(spots, 0, spots.length - 1);
        pen.stroke();
        pen.globalAlpha = 1;
      }
      if (picture.walk) footprints(project, picture.walk);
      if (picture.points.length > 1) stroke(project, picture);
      uncover(project);
      if (picture.faded) return;
      towards(project, picture.goal);
      if (!picture.pen || picture.waiting) ring(project, picture);
      const worst = picture.tight.reduce((/** @type {TightStretch | null} */ a, b) => (!a || b.near.metres < a.near.metres ? b : a), null);
      if (picture.problem) {
        const at = project(picture.problem.at[0], picture.problem.at[1]);
        if (at) {
          circle(project, picture.problem.at[0], picture.problem.at[1], 0.2);
          pen.strokeStyle = scheme.colour(RED);
          pen.lineWidth = 4;
          pen.stroke();
        }
        note(at, picture.problem.text, RED);
      } else if (worst && !picture.pen) {
        const at = picture.points[worst.worst];
        const hit = worst.near.metres < 0;
        note(project(at[0], at[1]), say(`${hit ? "would_hit" : "too_close"}.${worst.near.name}`), hit ? RED : AMBER);
      }
      if (picture.pen) {
        room(project, picture.pen);
        if (picture.cursor) {
          circle(project, picture.pen.at[0], picture.pen.at[1], 0.09);
          pen.fillStyle = scheme.colour(PAPER);
          pen.fill();
          pen.strokeStyle = scheme.colour(INK);
          pen.lineWidth = 3;
          pen.stroke();
        }
      }
    },
  };
})();
