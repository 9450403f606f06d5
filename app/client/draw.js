// @ts-check
/**
 * The pen: a path drawn on the floor with a speed at every point, by mouse, finger, pen or keys, all in this window.
 *
 * Sections are drawn one after the other; undo and redo walk through them. When the last one ends at the goal, or the
 * page says so, the whole stroke goes to the page as `stroke`. How it looks is ink.js's, whether it can be driven the
 * server's. Orders of the page: `{type: "draw", do, ...}`, see `told`.
 */
(() => {
  "use strict";
  const { bridge, ink, clearance } = window.desirePath;
  const SPACING_M = 0.015; // a point that is nearer to the last one says nothing new
  const BEGIN_M = 0.45; // ours: so near to the ring (or RING_PX) the pen is meant to be on it
  const RING_PX = 48; // a finger's width
  const KEY_STEP_M = 0.1;
  const FINE_KEY_STEP_M = 0.02;
  const SPEED_STEPS = 10; // of wheel and keys, from the slowest to the fastest
  const EDGE = 0.14; // of the window: near its edge the pen takes the gaze along
  const EDGE_RAD_PER_S = 0.6;
  const TELL_EVERY_MS = 120;
  const FARTHEST_M = 30; // a ray that hits the floor beyond is aimed at the horizon
  const MOST_POINTS = 4000;
  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  /**
   * @typedef {{points: number[][], speeds: number[], times: number[]}} Section
   * @typedef {object} Order what app/stage.py sends
   * @property {string} id of this sheet of paper: comes back with the stroke
   * @property {number[]} start x, y, yaw
   * @property {number[]} goal x, y, radius
   * @property {any[]} solids
   * @property {any} person
   * @property {number} robot_radius
   * @property {number[]} speeds slowest, fastest
   * @property {number[][][]} kept
   * @property {{points: number[][], speeds: number[]} | null} drawn a stroke that is there already
   * @property {boolean} resting nothing can be drawn now
   * @property {{at: number[] | null, thing: string | null} | null} problem with the stroke that is there
   * @property {number[][][]} walks to choose from, rows of t, x, y, yaw; none where the person stands
   * @property {number | null} chosen the one that the stroke is for
   */

  /** @type {Order | null} */
  let order = null;
  /** @type {Section[]} */
  let sections = [];
  /** Sections that undo took away, the newest last. @type {Section[][]} */
  let past = [];
  /** @type {Section[][]} */
  let future = [];
  /** @type {Section | null} */
  let open = null;
  let pointerId = -1;
  /** @type {Set<string>} */
  let pointers = new Set();
  /** Where the pointer is in the window. */
  let [px, py] = [0, 0];
  let speed = 0.2;
  /** @type {number[] | null} */
  let cursor = null;
  /** @type {(x: number, y: number, t: number) => any} */
  let nearest = () => null;
  /** Which walk of the order's. @type {number | null} */
  let walk = null;
  /** @type {{at: number[], text: string} | null} */
  let problem = null;
  let faded = false;
  let lastFrame = 0;
  let shownSince = 0;
  let lastTold = 0;
  let begunAt = 0;
  /** Everything below is computed anew only after a change. */
  let changed = true;
  /** @type {{points: number[][], speeds: number[], nears: any[], tight: any[], length: number, seconds: number}} */
  let whole = { points: [], speeds: [], nears: [], tight: [], length: 0, seconds: 0 };

  const end = () => {
    const last = sections[sections.length - 1];
    return last ? last.points[last.points.length - 1] : /** @type {Order} */ (order).start;
  };

  /** @param {number[]} a @param {number[]} b */
  const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

  function measure() {
    if (!changed) return whole;
    changed = false;
    const all = open ? [...sections, open] : sections;
    const points = all.flatMap((section) => section.points);
    const speeds = all.flatMap((section) => section.speeds);
    let [length, seconds] = [0, 0];
    // What was measured before stays, as a stroke only grows at its end or is cut there.
    const nears = points.map((point, i) => {
      const step = i ? apart(point, points[i - 1]) : 0;
      length += step;
      seconds += step / speeds[i];
      return whole.points[i] === point ? whole.nears[i] : nearest(point[0], point[1], seconds);
    });
    whole = { points, speeds, nears, tight: clearance.tight(nears), length, seconds };
    return whole;
  }

  const atGoal = () => order !== null && sections.length > 0 && apart(end(), order.goal) <= order.goal[2];

  /** Tells the page how it stands. @param {boolean} [now] */
  function tell(now = true) {
    const time = performance.now();
    if (!order || (!now && time - lastTold < TELL_EVERY_MS)) return;
    lastTold = time;
    const { points, nears, tight, length, seconds } = measure();
    const place = cursor ?? (points.length ? points[points.length - 1] : null);
    const near = place && (cursor ? nearAt(cursor) : nears[nears.length - 1]);
    const worst = tight.reduce((a, b) => (!a || b.near.metres < a.near.metres ? b : a), null);
    bridge.post("drawing", {
      drawing: open !== null,
      can_undo: past.length > 0,
      can_redo: future.length > 0,
      can_finish: !open && points.length > 1,
      at_goal: atGoal(),
      length_m: length,
      seconds,
      speed,
      speeds: order.speeds,
      near: near && { name: near.name, metres: near.metres },
      tight: worst && { name: worst.near.name, metres: worst.near.metres },
      keys: cursor !== null,
      problem: problem !== null,
      walk,
      must_choose: mustChoose(),
    });
  }

  /** Where somebody walks, it is chosen how before anything is drawn. */
  const mustChoose = () => order !== null && order.walks.length > 0 && walk === null;

  /** What is near to a place when the robot gets there straight from the end. @param {number[]} place */
  const nearAt = (place) => nearest(place[0], place[1], measure().seconds + apart(place, end()) / speed);

  /** The person walks so; what was drawn stays and is measured anew. @param {Order} given @param {number | null} which */
  function use(given, which) {
    walk = which;
    const track = which === null ? null : given.walks[which];
    nearest = clearance.of(given, track ? (/** @type {number} */ t) => window.desirePath.player.along(track, t) : undefined);
    [whole.points, changed, shownSince] = [[], true, performance.now()];
  }

  /** A change that undo can take back. */
  function remember() {
    past.push([...sections]);
    future = [];
    problem = null;
  }

  /** @param {number} next m/s */
  function setSpeed(next) {
    if (!order) return;
    const [low, high] = order.speeds;
    speed = Math.max(low, Math.min(high, next));
    ink.speed(speed);
    tell(false);
  }

  /** @param {number} steps */
  const nudge = (steps) => order && setSpeed(speed + (steps * (order.speeds[1] - order.speeds[0])) / SPEED_STEPS);

  /** Pens, and fingers on some screens, tell how hard they press: harder is faster. @param {PointerEvent} event */
  function speedByPressure(event) {
    if (!order || event.pointerType === "mouse") return;
    const told = event.pressure > 0 && event.pressure < 1 && (event.pointerType === "pen" || event.pressure !== 0.5);
    if (told) setSpeed(order.speeds[0] + event.pressure * (order.speeds[1] - order.speeds[0]));
  }

  /** @param {number[]} point @param {number} time ms */
  function add(point, time) {
    if (!open || whole.points.length > MOST_POINTS) return;
    const before = open.points[open.points.length - 1];
    if (before && apart(point, before) < SPACING_M) return;
    open.points.push(point);
    open.speeds.push(speed);
    open.times.push((time - begunAt) / 1000);
    changed = true;
  }

  /** @param {number} x @param {number} y pixels @param {number} time ms */
  function addAt(x, y, time) {
    const found = window.desirePath.viser.floorAt(x, y);
    if (found && order && apart(found, order.start) < FARTHEST_M) add(found, time);
  }

  /** @param {PointerEvent} event @returns {boolean} whether it begins a section */
  function touches(event) {
    const found = window.desirePath.viser.floorAt(event.clientX, event.clientY);
    if (document.documentElement.dataset.view === "top_down") return found !== null;
    const at = window.desirePath.viser.projector()(end()[0], end()[1]);
    const nearOnScreen = at && Math.hypot(at[0] - event.clientX, at[1] - event.clientY) <= RING_PX;
    return Boolean(nearOnScreen || (found && apart(found, end()) <= BEGIN_M));
  }

  function close() {
    if (!open) return;
    const section = open;
    open = null;
    changed = true;
    if (section.points.length > 1) {
      remember();
      sections = [...sections, section];
    }
    tell();
    if (atGoal() && section.points.length > 1 && !cursor) finish();
  }

  function finish() {
    const { points } = measure();
    if (!order || open || faded || points.length < 2) return;
    bridge.post("stroke", {
      id: order.id,
      walk,
      points: points.map((point) => point.map((value) => Math.round(value * 1e4) / 1e4)),
      speeds: sections.flatMap((section) => section.speeds).map((value) => Math.round(value * 1e4) / 1e4),
      times_s: sections.flatMap((section) => section.times).map((value) => Math.round(value * 1e3) / 1e3),
      pointer: [...pointers].sort().join("+") || "keys",
    });
  }

  /** What is touched, in the page's words. @param {string | null} thing */
  function thingWords(thing) {
    return thing ? ink.say(`would_hit.${thing === "person" && order ? order.person.name : thing}`) : "";
  }

  /** Back or forth through what was drawn. @param {Section[][]} from @param {Section[][]} to */
  function turnTo(from, to) {
    const next = from.pop();
    if (!next || open) return;
    to.push([...sections]);
    sections = next;
    problem = null;
    changed = true;
    if (cursor) cursor = end().slice(0, 2);
    tell();
  }

  /** Cuts the stroke shortly before a place, so that the good part need not be drawn again. @param {number[]} at */
  function cutBefore(at) {
    const { points } = measure();
    let hit = points.reduce((best, point, i) => (apart(point, at) < apart(points[best], at) ? i : best), 0);
    for (let back = 0; hit > 0 && back < 0.35; hit -= 1) back += apart(points[hit], points[hit - 1]);
    remember();
    let left = hit + 1;
    sections = sections.flatMap((section) => {
      const count = Math.min(left, section.points.length);
      left -= count;
      if (count === 0) return [];
      const cut = (/** @type {any[]} */ values) => values.slice(0, count);
      return [{ points: cut(section.points), speeds: cut(section.speeds), times: cut(section.times) }];
    });
    if (sections.flatMap((section) => section.points).length < 2) sections = [];
    changed = true;
    tell();
  }

  /** @param {number} right @param {number} down in the window @param {number} metres */
  function moveCursor(right, down, metres) {
    cursor ??= end().slice(0, 2);
    const { viser } = window.desirePath;
    const at = viser.projector()(cursor[0], cursor[1]);
    const [a, b] = at ? [viser.floorAt(at[0], at[1]), viser.floorAt(at[0] + 6 * right, at[1] + 6 * down)] : [null, null];
    // Away over the floor is up in the picture; where the cursor is out of sight, the world's own directions.
    const [dx, dy] = a && b ? [b[0] - a[0], b[1] - a[1]] : [right, -down];
    const size = Math.hypot(dx, dy) || 1;
    cursor = [cursor[0] + (metres * dx) / size, cursor[1] + (metres * dy) / size];
    const seen = viser.projector()(cursor[0], cursor[1]);
    if (seen) followWithGaze(seen[0], seen[1]);
    tell(false);
  }

  /** A waypoint: straight from the last one; the spline through all of them is the server's. */
  function waypoint() {
    if (!cursor || apart(cursor, end()) < SPACING_M) return;
    const [from, to] = [end(), cursor];
    pointers.add("keys");
    begunAt ||= performance.now();
    const count = Math.max(1, Math.round(apart(from, to) / 0.05));
    const time = (performance.now() - begunAt) / 1000;
    /** @type {Section} */
    const section = { points: [], speeds: [], times: [] };
    for (let k = sections.length ? 1 : 0; k <= count; k += 1) {
      section.points.push([from[0] + ((to[0] - from[0]) * k) / count, from[1] + ((to[1] - from[1]) * k) / count]);
      section.speeds.push(speed);
      section.times.push(time);
    }
    remember();
    sections = [...sections, section];
    changed = true;
    tell();
  }

  /** Near the window's edge the gaze goes along. @param {number} x @param {number} y pixels @param {number} [seconds] */
  function followWithGaze(x, y, seconds = 0.12) {
    const over = (/** @type {number} */ at, /** @type {number} */ size) =>
      at < EDGE * size ? (EDGE * size - at) / (EDGE * size) : at > (1 - EDGE) * size ? -(at - (1 - EDGE) * size) / (EDGE * size) : 0;
    const [left, up] = [over(x, window.innerWidth), over(y, window.innerHeight)];
    if (left || up) window.desirePath.camera.turn(left * EDGE_RAD_PER_S * seconds, up * EDGE_RAD_PER_S * seconds);
  }

  function frame() {
    if (!order) return;
    const now = performance.now();
    const seconds = Math.min(0.1, (now - lastFrame) / 1000);
    lastFrame = now;
    if (open) {
      followWithGaze(px, py, seconds);
      if (window.desirePath.camera.mayTurn()) addAt(px, py, now);
      tell(false);
    }
    const { points, speeds, nears, tight } = measure();
    const last = points.length - 1;
    const track = order.walks[walk ?? -1];
    if (track && !faded) {
      // While the pen moves the person is where they will be by then; before that they show the way they walk.
      const rests = 1.5;
      const show = ((now - shownSince) / 1000) % (track[track.length - 1][0] + rests);
      window.desirePath.player.walkTo(track, open || cursor || sections.length ? measure().seconds : show);
    }
    const pen = cursor ? { at: cursor, near: nearAt(cursor) }
      : open && last >= 0 ? { at: points[last], near: nears[last] } : null;
    const line = cursor ? { points: [...points, cursor], speeds: [...speeds, speed] } : { points, speeds };
    if (cursor && !points.length) line.points.unshift(order.start), line.speeds.unshift(speed);
    ink.paint({
      ...line, faded, tight, problem, begin: end(), waiting: !open && !cursor && !atGoal() && !problem && !mustChoose(),
      walk: faded ? null : track ?? null,
      goal: order.goal, kept: order.kept, pen: faded ? null : pen, cursor: cursor !== null,
    });
    requestAnimationFrame(frame);
  }

  const { element } = window.desirePath.sheet;
  element.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
    if (!open || event.pointerId !== pointerId) return;
    const told = event.getCoalescedEvents?.() ?? [];
    for (const one of told.length ? told : [event]) {
      speedByPressure(one);
      addAt(one.clientX, one.clientY, one.timeStamp);
    }
    [px, py] = [event.clientX, event.clientY];
  });
  for (const type of ["pointerup", "pointercancel"]) {
    element.addEventListener(type, (/** @type {PointerEvent} */ event) => {
      if (event.pointerId !== pointerId) return;
      pointerId = -1;
      close();
    });
  }
  element.addEventListener("wheel", (/** @type {WheelEvent} */ event) => {
    if (order && !faded) nudge(-Math.sign(event.deltaY));
  });

  window.desirePath.draw = {
    /** A new sheet of paper. @param {Order} given */
    begin(given) {
      const another = order === null;
      order = given;
      sections = given.drawn ? [{ ...given.drawn, times: given.drawn.points.map(() => 0) }] : [];
      [past, future, open, cursor, faded] = [[], [], null, null, false];
      [begunAt, pointers, changed, whole.points] = [0, new Set(), true, []];
      use(given, given.chosen);
      problem = given.problem && { at: given.problem.at ?? end(), text: thingWords(given.problem.thing) };
      document.documentElement.dataset.drawing = "on";
      ink.speeds(given.speeds[0], given.speeds[1]);
      setSpeed(another ? (given.speeds[0] + given.speeds[1]) / 2 : speed);
      ink.show(true);
      window.desirePath.camera.gaze([
        0.6 * given.start[0] + 0.4 * given.goal[0], 0.6 * given.start[1] + 0.4 * given.goal[1],
      ]);
      lastFrame = performance.now();
      if (another) requestAnimationFrame(frame);
      tell();
      if (given.resting) this.rest();
    },

    /** The robot drives: the pen rests, what was drawn stays in sight. */
    rest() {
      if (!order) return;
      faded = true;
      [open, cursor] = [null, null];
      document.documentElement.dataset.drawing = "rests";
      window.desirePath.camera.gaze(null);
    },

    /** No drawing on this scene. */
    stop() {
      order = null;
      sections = [];
      delete document.documentElement.dataset.drawing;
      ink.show(false);
    },

    /** What the page orders. @param {any} message */
    told(message) {
      if (message.do === "words") ink.use(message.words);
      else if (message.do === "look") window.desirePath.camera[message.from === "side" ? "release" : "hold"]();
      else if (message.do === "step") window.desirePath.walk.key({ key: String(message.key) }, Boolean(message.down));
      if (!order || faded) return;
      if (message.do === "undo") turnTo(past, future);
      else if (message.do === "redo") turnTo(future, past);
      else if (message.do === "clear") {
        if (sections.length) remember();
        [sections, cursor, changed] = [[], null, true];
        tell();
      } else if (message.do === "finish") finish();
      else if (message.do === "speed") setSpeed(Number(message.value));
      else if (message.do === "problem") problem = { at: message.at ?? end(), text: String(message.text ?? "") };
      else if (message.do === "choose" && order.walks[message.walk]) {
        use(order, message.walk);
        problem = null;
        tell();
      }
      else if (message.do === "cut" && problem) cutBefore(problem.at);
      else if (message.do === "key") this.key({ key: String(message.key), shiftKey: Boolean(message.shift) });
    },

    /** A pointer went down on the sheet. @param {PointerEvent} event @returns {boolean} whether the pen takes it */
    press(event) {
      if (!order || faded || open || event.button !== 0 || mustChoose() || !touches(event)) return false;
      begunAt ||= event.timeStamp;
      pointerId = event.pointerId;
      [px, py] = [event.clientX, event.clientY];
      pointers.add(event.pointerType || "mouse");
      element.setPointerCapture(event.pointerId);
      cursor = null;
      problem = null;
      open = { points: [], speeds: [], times: [] };
      const found = window.desirePath.viser.floorAt(px, py);
      speedByPressure(event);
      // Begun on the ring: the line starts where the robot stands, or where the section before ended.
      if (!found || apart(found, end()) <= BEGIN_M) {
        if (sections.length === 0) add(end().slice(0, 2), event.timeStamp);
      } else add(found, event.timeStamp);
      tell();
      return true;
    },

    /** @param {{key: string, shiftKey?: boolean, ctrlKey?: boolean, metaKey?: boolean}} event @returns {boolean} whether it was for the pen */
    key(event) {
      if (!order || faded || mustChoose()) return false;
      const { key } = event;
      if ((event.ctrlKey || event.metaKey) && key.toLowerCase() === "z") {
        if (event.shiftKey) turnTo(future, past);
        else turnTo(past, future);
      } else if (event.ctrlKey || event.metaKey) return false;
      else if (key in ARROWS) {
        const [right, down] = ARROWS[/** @type {keyof ARROWS} */ (key)];
        moveCursor(right, down, event.shiftKey ? FINE_KEY_STEP_M : KEY_STEP_M);
      } else if (key === "Enter" && cursor) waypoint();
      else if (key === "Backspace") turnTo(past, future);
      else if (key === "+" || key === "-") nudge(key === "+" ? 1 : -1);
      else return false;
      return true;
    },
  };
})();
