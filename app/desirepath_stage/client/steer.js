// @ts-check
/**
 * Paths that robots would take from where they are, redrawn whenever the page sends others, and robots that drive them.
 *
 * The page asks the server for a path and sends it down here, so that nothing waits for viser. A robot under way goes
 * on along its new path; where it is, is told to the page (`moved`), which asks for the next path from there.
 */
(() => {
  "use strict";
  const { bridge, frames } = window.desirePath;
  const RIBBON_M = 0.13;
  const TELL_EVERY_MS = 60;
  const TAG_PX = 12;
  const AHEAD_S = 1.5; // a path that was asked for so long ago still begins behind the robot
  const CASING = "--paper";
  const BEHIND = "--behind"; // opaque, as pieces that shine through would show where they overlap
  const { scheme } = window.desirePath;

  const { canvas, pen, fit, size, due, projector, uncover } = window.desirePath.overlay("desire-path-ribbon");

  /** @type {LivePath[]} */
  let paths = [];
  /** The order that is to be told of once it has been drawn. @type {string | null} */
  let fresh = null;
  /** Where each robot is along its path, s. @type {number[]} */
  let along = [];
  /** For how long each had been under way when its path began, s. @type {number[]} */
  let since = [];
  let driving = false;
  let inTurn = false;
  /** Of one robot's ways, told apart by numbers, the one that it drives; null: each robot has its own. @type {number | null} */
  let only = null;
  /** Where each of them has its number, x and y. @type {number[][]} */
  let tags = [];
  /** @type {Track | null} */
  let walked = null;
  /** A drive that was asked for before its ways were there. @type {any} */
  let pending = null;
  let lastFrame = 0;
  let toldAt = 0;
  let running = false;

  /** @param {LivePath} path @param {number} t s @returns {number[]} x, y, yaw */
  const at = (path, t) => window.desirePath.player.along(path.track, t);
  const ends = (/** @type {LivePath} */ path) => path.track[path.track.length - 1][0];

  /** The time on a new path at which the robot is nearest to where it stands. @param {LivePath} path @param {number[]} here */
  function nearest(path, here) {
    let [best, distance] = [0, Infinity];
    for (let t = 0; t <= Math.min(AHEAD_S, ends(path)); t += 0.02) {
      const [x, y] = at(path, t);
      const apart = Math.hypot(x - here[0], y - here[1]);
      if (apart < distance - 1e-6) [best, distance] = [t, apart];
    }
    return best;
  }

  /** Where the robots were put, so that the room is not drawn anew for a robot that stands where it stood. */
  let stand = "";
  function place() {
    if (only !== null) {
      window.desirePath.player.walkCrowdTo(along[only]);
      if (walked) window.desirePath.player.walkTo(walked, along[only]);
      window.desirePath.player.place(0, at(paths[only], along[only]), true);
      return;
    }
    const first = along.findIndex((t, i) => t < ends(paths[i]));
    const watched = inTurn ? first : 0;
    const poses = paths.map((path, i) => at(path, along[i]));
    const times = clocks();
    const people = inTurn ? times[first < 0 ? times.length - 1 : first] : Math.max(...times);
    const now = JSON.stringify([poses, watched, people]);
    if (now === stand) return;
    stand = now;
    window.desirePath.player.walkCrowdTo(people);
    poses.forEach((pose, i) => window.desirePath.player.place(i, pose, i === watched));
  }

  /** For how long each robot has been under way, s: so long have people been walking around it. */
  const clocks = () => along.map((t, i) => since[i] + t);

  /** @param {boolean} over whether all robots have come to their ends */
  function tell(over) {
    toldAt = performance.now();
    const poses = paths.map((path, i) => at(path, along[i]));
    bridge.post("moved", { poses, clocks: clocks(), seconds: Math.max(0, ...along), driving, over });
  }

  /** Where a way is farthest from all others: there stands its number. @param {Track} track @param {Track[]} others */
  function apart(track, others) {
    const gap = (/** @type {number[]} */ [, x, y]) => Math.min(...others.flat().map(([, u, v]) => Math.hypot(x - u, y - v)));
    return track.reduce((best, row) => (gap(row) > gap(best) ? row : best)).slice(1, 3);
  }

  /** @param {Projector} project @param {number} i */
  function tag(project, i) {
    const spot = project(tags[i][0], tags[i][1]);
    if (!spot) return;
    pen.fillStyle = `rgb(${paths[i].colour.join(" ")})`;
    pen.strokeStyle = "white";
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(spot[0], spot[1], TAG_PX, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
    pen.fillStyle = "white";
    pen.font = `600 ${1.2 * TAG_PX}px sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(String(i + 1), spot[0], spot[1] + 1);
  }

  /** @param {Projector} project @param {LivePath} path @param {number} from s: what lies behind the robot is faint */
  function ribbon(project, path, from) {
    const { track, colour, arrives, hollow } = path;
    const spots = track.map(([, x, y]) => project(x, y));
    const beside = track.map(([, x, y]) => project(x, y + RIBBON_M) ?? project(x + RIBBON_M, y));
    const wide = spots.map((spot, i) => {
      const other = beside[i];
      return spot && other ? Math.max(4, Math.min(40, Math.hypot(spot[0] - other[0], spot[1] - other[1]))) : 6;
    });
    const own = `rgb(${colour.join(" ")})`;
    const layers = /** @type {[number, string][]} */ ([[4, scheme.colour(CASING)], [0, own], ...(hollow ? [[-0.5, scheme.colour(CASING)]] : [])]);
    for (const [more, ink] of layers) {
      for (let i = 1; i < track.length; i += 1) {
        const [a, b] = [spots[i - 1], spots[i]];
        if (!a || !b) continue;
        if (!arrives && i % 3 === 0) continue; // broken: it does not arrive
        pen.strokeStyle = track[i][0] > from ? ink : scheme.colour(BEHIND);
        pen.lineWidth = more < 0 ? wide[i] * -more : wide[i] + more;
        pen.beginPath();
        pen.moveTo(a[0], a[1]);
        pen.lineTo(b[0], b[1]);
        pen.stroke();
      }
    }
    // A dot for every second: where they are close together the robot is slow.
    pen.fillStyle = hollow ? own : "white";
    for (let second = 1; second < ends(path); second += 1) {
      const [x, y] = at(path, second);
      const spot = project(x, y);
      if (!spot || second <= from) continue;
      pen.beginPath();
      pen.arc(spot[0], spot[1], 2.6, 0, 2 * Math.PI);
      pen.fill();
    }
  }

  /** Whether anything would look different from what is painted: a canvas of the window's size costs its time. */
  let painted = "";
  function paint() {
    if (!due()) return;
    const project = projector();
    const seen = paths.flatMap(({ track }) => [project(track[0][1], track[0][2]), project(0, 0), project(1, 1)]);
    const now = JSON.stringify([size(), scheme.isDark(), along, driving, seen]);
    if (now === painted && fresh === null) return;
    painted = now;
    fit();
    // what lies behind a robot is faint while any drives; then whole ways are to be told apart again
    for (let i = paths.length - 1; i >= 0; i -= 1) if (i !== only) ribbon(project, paths[i], driving ? (only === null ? (along[i] ?? 0) : Infinity) : 0);
    if (only !== null) ribbon(project, paths[only], driving ? along[only] : 0);
    for (let i = 0; i < tags.length; i += 1) tag(project, i);
    uncover(project);
    if (fresh !== null) {
      bridge.post("drawn", { id: fresh });
      fresh = null;
    }
  }

  function step() {
    if (!running) return;
    const now = performance.now();
    if (driving) {
      const passed = (now - lastFrame) / 1000;
      const alone = only ?? (inTurn ? along.findIndex((t, i) => t < ends(paths[i])) : null);
      along = along.map((t, i) => (alone !== null && i !== alone ? t : Math.min(ends(paths[i]), t + passed)));
      place();
      const over = along.every((t, i) => t >= ends(paths[i]) || (only !== null && i !== only));
      if (over) driving = false;
      if (over || now - toldAt > TELL_EVERY_MS) tell(over);
    }
    lastFrame = now;
    if (window.desirePath.viser.isUp()) paint();
    frames.next(step);
  }

  window.desirePath.steer = {
    /** @param {any} message from the page */
    obey(message) {
      if (message.do === "paths") {
        const here = paths.map((path, i) => at(path, along[i]));
        const goesOn = message.onward && here.length === message.paths.length;
        paths = message.paths;
        along = paths.map((path, i) => (goesOn ? nearest(path, here[i]) : 0));
        since = paths.map((_, i) => (goesOn && message.since?.[i]) || 0);
        fresh = message.id;
        tags = message.numbered ? paths.map(({ track }, i) => apart(track, paths.filter((_, k) => k !== i).map((other) => other.track))) : [];
        only = message.numbered ? 0 : null;
        walked = message.person ?? null;
        if (!goesOn) {
          driving = false;
          if (paths.length) place(); // without any, the robots stay where they are
        }
        if (!running) {
          running = true;
          lastFrame = performance.now();
          window.desirePath.sheet.element.prepend(canvas);
          frames.next(step);
        }
        window.desirePath.sheet.legend(message.legend ?? []);
        if (pending !== null) this.obey(pending);
        pending = null;
      } else if (message.do === "drive" && !paths.length) {
        pending = message; // the ways that the server sends come a moment after the room
      } else if (message.do === "drive") {
        if (only !== null) only = Number(message.only);
        if (only !== null || along.every((t, i) => t >= ends(paths[i]))) along = paths.map(() => 0);
        lastFrame = performance.now();
        inTurn = Boolean(message.in_turn);
        driving = true;
      } else if (message.do === "stop") {
        driving = false;
        tell(false);
      }
    },
    /** Another scene stands there: nothing of this one is left. */
    stop() {
      running = driving = false;
      [paths, along, since, fresh, tags, only, walked, pending] = [[], [], [], null, [], null, null, null];
      stand = painted = "";
      canvas.remove();
    },
  };
})();
