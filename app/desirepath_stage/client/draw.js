// @ts-check
/**
 * The pen: a path drawn on the floor with a speed at every point, by mouse, finger, pen or keys, all in this window, or by
 * the ray of a hand with a headset (headset.js), which gives places on the floor.
 *
 * Sections are drawn one after the other (sections.js). When the last one ends at the goal, or the page says so, the whole
 * stroke goes to the page as `stroke`. How it looks is ink.js's, whether it can be driven the server's. Orders of the
 * page: `{type: "draw", do, ...}`, see `obey`.
 */
(() => {
  "use strict";
  const { bridge, frames, ink, clearance, sections } = window.desirePath;
  const { apart, end, measure } = sections;
  const BEGIN_M = 0.45; // ours: so near to the ring (or RING_PX) the pen is meant to be on it
  const RING_PX = 48; // a finger's width
  const KEY_STEP_M = 0.1;
  const FINE_KEY_STEP_M = 0.02;
  const SPEED_STEPS = 10; // of wheel and keys, from the slowest to the fastest
  const EDGE = 0.14; // of the window: near its edge the pen takes the gaze along
  const EDGE_RAD_PER_S = 0.6;
  const TELL_EVERY_MS = 120;
  const FARTHEST_M = 30; // a ray that hits the floor beyond is aimed at the horizon
  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  /** @type {Orders["draw"] | null} */
  let order = null;
  let pointerId = -1;
  /** Whether a hand with a headset has the pen. */
  let inHand = false;
  /** @type {Set<string>} */
  let pointers = new Set();
  /** Where the pointer is in the window. */
  let [px, py] = [0, 0];
  let speed = 0.2;
  /** @type {number[] | null} */
  let cursor = null;
  /** @type {Finds} */
  let nearest = () => ({ name: "", metres: Infinity, at: [0, 0] });
  /** Which walk of the order's. @type {number | null} */
  let walk = null;
  /** What the server found. @type {{code: string, at: number[], text: string} | null} */
  let problem = null;
  let faded = false;
  let lastFrame = 0;
  let shownSince = 0;
  let lastSent = 0;

  const atGoal = () => order !== null && sections.any() && apart(end(), order.goal) <= order.goal[2];

  /** Tells the page how it stands. @param {boolean} [now] */
  function tell(now = true) {
    const time = performance.now();
    if (!order || (!now && time - lastSent < TELL_EVERY_MS)) return;
    lastSent = time;
    const { points, nears, tight, length, seconds } = measure();
    const place = cursor ?? (points.length ? points[points.length - 1] : null);
    const near = place && (cursor ? nearAt(cursor) : nears[nears.length - 1]);
    const worst = tight.reduce((/** @type {TightStretch | null} */ a, b) => (!a || b.near.metres < a.near.metres ? b : a), null);
    /** @type {PenState} */
    const stands = {
      drawing: sections.isOpen(),
      can_undo: sections.canUndo(),
      can_redo: sections.canRedo(),
      can_finish: !sections.isOpen() && points.length > 1,
      at_goal: atGoal(),
      length_m: length,
      seconds,
      speed,
      speeds: order.speeds,
      near: near && { name: near.name, metres: near.metres, tight: near.metres < order.tight_m },
      tight: worst && { name: worst.near.name, metres: worst.near.metres, tight: true },
      keys: cursor !== null,
      problem: problem !== null,
      walk,
      must_choose: mustChoose(),
    };
    bridge.post("drawing", stands);
  }

  /** Where somebody walks, it is chosen how before anything is drawn. */
  const mustChoose = () => order !== null && order.walks.length > 0 && walk === null;

  /** What is near to a place when the robot gets there straight from the end. @param {number[]} place */
  const nearAt = (place) => nearest(place[0], place[1], measure().seconds + apart(place, end()) / speed);

  /** The person walks so; what was drawn stays and is measured anew. @param {Orders["draw"]} given @param {number | null} which */
  function use(given, which) {
    walk = which;
    const track = which === null ? null : given.walks[which];
    const personAt = track ? (/** @type {number} */ t) => window.desirePath.player.along(track, t) : undefined;
    nearest = clearance.of(given, personAt);
    sections.measureBy(nearest);
    shownSince = performance.now();
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
    const felt = event.pressure > 0 && event.pressure < 1 && (event.pointerType === "pen" || event.pressure !== 0.5);
    if (felt) setSpeed(order.speeds[0] + event.pressure * (order.speeds[1] - order.speeds[0]));
  }

  /** @param {number} x @param {number} y pixels @param {number} time ms */
  function addAt(x, y, time) {
    goTo(window.desirePath.viser.floorAt(x, y), time);
  }

  /** @param {number[] | null} found on the floor @param {number} time ms */
  function goTo(found, time) {
    if (found && order && apart(found, order.start) < FARTHEST_M) sections.add(found, speed, time);
  }

  /** @param {PointerEvent} event @returns {boolean} whether it begins a section */
  function touches(event) {
    const found = window.desirePath.viser.floorAt(event.clientX, event.clientY);
    if (document.documentElement.dataset.view === "top_down") return found !== null;
    if (found && touchesAt(found)) return true;
    const [x, y] = begin();
    const at = window.desirePath.viser.projector()(x, y);
    return Boolean(at && Math.hypot(at[0] - event.clientX, at[1] - event.clientY) <= RING_PX);
  }
  const touchesAt = (/** @type {number[]} */ found) => apart(found, begin()) <= BEGIN_M;

  const mayPress = () => !window.desirePath.headset.needed() && order !== null && !faded && !sections.isOpen() && !mustChoose();

  /** The pen is put down. @param {number[] | null} found there @param {string} pointer @param {number} time ms @param {() => void} [feel] how fast */
  function put(found, pointer, time, feel = () => {}) {
    if (!order) return;
    if (!sections.any()) pointers.clear(); // all that is there is drawn from now on
    pointers.add(pointer);
    if (beginsAway() && (!found || apart(found, order.start) <= BEGIN_M)) sections.clear(); // undo brings it back
    cursor = null;
    problem = null;
    sections.put();
    feel();
    // Begun on the ring: the line starts where the robot stands, or where the section before ended.
    if (!found || apart(found, end()) <= BEGIN_M) {
      if (!sections.any()) sections.add(end().slice(0, 2), speed, time);
    } else sections.add(found, speed, time);
    tell();
  }

  function close() {
    if (!sections.isOpen()) return;
    const drawn = sections.lift();
    tell();
    if (drawn && atGoal()) finish();
  }

  function finish() {
    if (!order || sections.isOpen() || faded || measure().points.length < 2) return;
    bridge.post("stroke", {
      id: order.id,
      walk,
      headset: window.desirePath.headset.report(),
      ...sections.stroke(),
      pointer: [...pointers].sort().join("+") || "keys",
    });
  }

  /** Where the next section begins: at the robot again, where what is there began too far away from it. */
  const begin = () => (order && beginsAway() ? order.start : end());
  const beginsAway = () => problem?.code === "starts_away";

  /** What is touched, in the page's words. @param {string | null} thing */
  function thingWords(thing) {
    return thing ? ink.say(`would_hit.${thing === "person" && order ? order.person.name : thing}`) : "";
  }

  /** After the stroke was changed by other than the pen. */
  function turned() {
    problem = null;
    if (cursor) cursor = end().slice(0, 2);
    tell();
  }
  const undo = () => !sections.isOpen() && sections.undo() && turned();
  const redo = () => !sections.isOpen() && sections.redo() && turned();

  /** @param {number} right @param {number} down in the window @param {number} metres */
  function moveCursor(right, down, metres) {
    const from = cursor ?? end().slice(0, 2);
    const { viser } = window.desirePath;
    const at = viser.projector()(from[0], from[1]);
    const [a, b] = at ? [viser.floorAt(at[0], at[1]), viser.floorAt(at[0] + 6 * right, at[1] + 6 * down)] : [null, null];
    // Away over the floor is up in the picture; where the cursor is out of sight, the world's own directions.
    const [dx, dy] = a && b ? [b[0] - a[0], b[1] - a[1]] : [right, -down];
    const size = Math.hypot(dx, dy) || 1;
    const to = (cursor = [from[0] + (metres * dx) / size, from[1] + (metres * dy) / size]);
    const seen = viser.projector()(to[0], to[1]);
    if (seen) followWithGaze(seen[0], seen[1]);
    tell(false);
  }

  /** A waypoint: straight from the last one; the spline through all of them is the server's. */
  function waypoint() {
    if (!cursor || !sections.straightTo(cursor, speed, performance.now())) return;
    pointers.add("keys");
    problem = null;
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
    const down = sections.isOpen();
    if (down && !inHand) {
      followWithGaze(px, py, seconds);
      if (window.desirePath.camera.mayTurn()) addAt(px, py, now);
    }
    if (down) tell(false);
    const { points, speeds, nears, tight } = measure();
    const last = points.length - 1;
    const track = order.walks[walk ?? -1];
    if (track && !faded) {
      // While the pen moves the person is where they will be by then; before that they show the way they walk.
      const rests = 1.5;
      const show = ((now - shownSince) / 1000) % (track[track.length - 1][0] + rests);
      window.desirePath.player.walkTo(track, down || cursor || sections.any() ? measure().seconds : show);
    }
    const at = cursor ?? (down && last >= 0 ? points[last] : null);
    const near = cursor ? nearAt(cursor) : nears[last];
    const pen = at && { at, near, tight: near.metres < order.tight_m };
    const line = cursor ? { points: [...points, cursor], speeds: [...speeds, speed] } : { points, speeds };
    if (cursor && !points.length) line.points.unshift(order.start), line.speeds.unshift(speed);
    ink.paint({
      ...line, faded, tight, problem, begin: begin(), onward: sections.any() && !beginsAway(),
      waiting: !down && !cursor && !mustChoose() && (problem ? beginsAway() : !atGoal()),
      walk: faded ? null : track ?? null,
      goal: order.goal, kept: order.kept, pen: faded ? null : pen, cursor: cursor !== null,
    });
    frames.next(frame);
  }

  const { element } = window.desirePath.sheet;
  element.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
    if (!sections.isOpen() || event.pointerId !== pointerId) return;
    const events = event.getCoalescedEvents?.() ?? [];
    for (const one of events.length ? events : [event]) {
      speedByPressure(one);
      addAt(one.clientX, one.clientY, one.timeStamp);
    }
    [px, py] = [event.clientX, event.clientY];
  });
  for (const type of /** @type {("pointerup" | "pointercancel")[]} */ (["pointerup", "pointercancel"])) {
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
    /** What `key` takes. */
    KEYS: [...Object.keys(ARROWS), "Enter", "Backspace", "+", "-"],

    /** A new sheet of paper. @param {Orders["draw"]} given */
    begin(given) {
      const another = order === null;
      order = given;
      sections.begin(given.start, given.drawn, given);
      [cursor, faded, inHand, pointers] = [null, false, false, new Set()];
      window.desirePath.headset.begin();
      use(given, given.chosen);
      problem = given.problem && { ...given.problem, at: given.problem.at ?? end(), text: thingWords(given.problem.thing) };
      document.documentElement.dataset.drawing = "on";
      ink.speeds(given.speeds[0], given.speeds[1]);
      setSpeed(another ? (given.speeds[0] + given.speeds[1]) / 2 : speed);
      ink.show(true);
      window.desirePath.camera.gaze([
        0.6 * given.start[0] + 0.4 * given.goal[0], 0.6 * given.start[1] + 0.4 * given.goal[1],
      ]);
      lastFrame = performance.now();
      if (another) frames.next(frame);
      tell();
      if (given.resting) this.rest();
    },

    /** The robot drives: the pen rests, what was drawn stays in sight. */
    rest() {
      if (!order) return;
      faded = true;
      sections.drop();
      cursor = null;
      document.documentElement.dataset.drawing = "rests";
      window.desirePath.camera.gaze(null);
    },

    /** No drawing on this scene. */
    stop() {
      order = null;
      delete document.documentElement.dataset.drawing;
      ink.show(false);
    },

    /** What the page orders. @param {any} message */
    obey(message) {
      if (message.do === "words") ink.use(message.words);
      else if (message.do === "look") window.desirePath.camera[message.from === "side" ? "release" : "hold"]();
      else if (message.do === "step") window.desirePath.walk.key({ key: String(message.key) }, Boolean(message.down));
      if (!order || faded) return;
      if (message.do === "undo") undo();
      else if (message.do === "redo") redo();
      else if (message.do === "clear") {
        sections.clear();
        cursor = null;
        turned();
      } else if (message.do === "finish") finish();
      else if (message.do === "speed") setSpeed(Number(message.value));
      else if (message.do === "problem") {
        problem = { code: String(message.code), at: message.at ?? end(), text: String(message.text ?? "") };
      } else if (message.do === "choose" && order.walks[message.walk]) {
        use(order, message.walk);
        problem = null;
        tell();
      } else if (message.do === "cut" && problem) {
        sections.cutBefore(problem.at);
        turned();
      } else if (message.do === "key") this.key({ key: String(message.key), shiftKey: Boolean(message.shift) });
    },

    /** A pointer went down on the sheet. @param {PointerEvent} event @returns {boolean} whether the pen takes it */
    press(event) {
      if (!mayPress() || event.button !== 0 || !touches(event)) return false;
      pointerId = event.pointerId;
      [px, py] = [event.clientX, event.clientY];
      element.setPointerCapture(event.pointerId);
      put(window.desirePath.viser.floorAt(px, py), event.pointerType || "mouse", event.timeStamp, () => speedByPressure(event));
      return true;
    },

    /** Whether there is something to draw on now. */
    waits: () => order !== null && !faded,

    /** A hand with a headset: the pen put down on the floor, moved over it, lifted. @type {DesirePath["draw"]["hand"]} */
    hand: {
      put(found, pointer) {
        if (!mayPress() || !touchesAt(found)) return false;
        inHand = true;
        put(found, pointer, performance.now());
        return true;
      },
      move(found) {
        if (inHand) goTo(found, performance.now());
      },
      lift() {
        if (!inHand) return;
        inHand = false;
        close();
      },
      faster: nudge,
    },

    /** @param {{key: string, shiftKey?: boolean, ctrlKey?: boolean, metaKey?: boolean}} event @returns {boolean} whether it was for the pen */
    key(event) {
      if (!order || faded || mustChoose() || window.desirePath.headset.needed()) return false;
      const { key } = event;
      if ((event.ctrlKey || event.metaKey) && key.toLowerCase() === "z") {
        if (event.shiftKey) redo();
        else undo();
      } else if (event.ctrlKey || event.metaKey) return false;
      else if (key in ARROWS) {
        const [right, down] = ARROWS[/** @type {keyof ARROWS} */ (key)];
        moveCursor(right, down, event.shiftKey ? FINE_KEY_STEP_M : KEY_STEP_M);
      } else if (key === "Enter" && cursor) waypoint();
      else if (key === "Backspace") undo();
      else if (key === "+" || key === "-") nudge(key === "+" ? 1 : -1);
      else return false;
      return true;
    },
  };
})();
