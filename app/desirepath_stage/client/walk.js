// @ts-check
/**
 * The participant on their own feet while the robot drives: by keys, a stick for the thumb, or a drag that turns; with a
 * headset by real steps and the stick of a controller.
 *
 * Moves in steps of fixed length, whatever the pictures do, and records every one: raw poses, STEP_S apart. Walls and
 * furniture are slid along, the robot is stopped for; it may still drive into who stands in its way.
 */
(() => {
  "use strict";
  const STEP_S = 1 / 30;
  const FORWARD_M_S = 1.2; // a calm walk; people reach 1.4
  const ASIDE_M_S = 0.8; // sideways and backwards
  const TURN_RAD_S = 1.5;
  const EASE_S = 0.12; // to come to speed and to stand again
  const BEFORE_ROBOT_M = 0.05; // nobody steps nearer to its edge than this
  const STICK_PX = 46; // of full speed
  const SHORT_M = 0.05; // shorter than a wall is thick
  const KEYS = {
    w: "forward", ArrowUp: "forward", s: "back", ArrowDown: "back", a: "left", d: "right",
    q: "turnLeft", ArrowLeft: "turnLeft", e: "turnRight", ArrowRight: "turnRight",
  };

  /** @type {Surroundings | null} */
  let ground = null;
  /** @type {Set<string>} */
  const held = new Set();
  /** The thumb's push, -1 to 1 to the right and ahead. */
  let push = [0, 0];
  let [x, y] = [0, 0];
  /** Speed ahead and to the left. */
  let going = [0, 0];
  let steps = 0;
  /** @type {number[]} */
  let times = [];
  /** @type {number[][]} */
  let poses = [];
  /** Where the head of who wears a headset was, as far as that was walked: the person is as near to it as walls let them. @type {number[] | null} */
  let led = null;

  const stick = document.createElement("div");
  stick.id = "desire-path-stick";
  stick.setAttribute("aria-hidden", "true"); // the keys do the same
  const knob = document.createElement("i");
  stick.append(knob);
  let thumb = -1;

  /** @param {PointerEvent} event */
  function lean(event) {
    const box = stick.getBoundingClientRect();
    const [right, down] = [event.clientX - box.x - box.width / 2, event.clientY - box.y - box.height / 2];
    const size = Math.max(STICK_PX, Math.hypot(right, down));
    push = [right / size, -down / size];
    knob.style.transform = `translate(${push[0] * STICK_PX}px, ${-push[1] * STICK_PX}px)`;
  }
  function letGo() {
    thumb = -1;
    push = [0, 0];
    knob.style.transform = "";
  }
  stick.addEventListener("pointerdown", (event) => {
    event.stopPropagation(); // what is beside the stick turns the head
    if (thumb !== -1) return;
    thumb = event.pointerId;
    stick.setPointerCapture(thumb);
    lean(event);
  });
  stick.addEventListener("pointermove", (event) => {
    if (event.pointerId === thumb) lean(event);
  });
  for (const type of ["pointerup", "pointercancel"]) {
    stick.addEventListener(type, (event) => {
      if (/** @type {PointerEvent} */ (event).pointerId === thumb) letGo();
    });
  }

  const is = (/** @type {string} */ what) => (held.has(what) ? 1 : 0);

  /** Out of whatever solid that place is in, along its surface. @param {number} px @param {number} py */
  function slid(px, py) {
    if (!ground) return [px, py];
    const { radius } = ground.person;
    for (const solid of ground.solids) {
      const { metres, at } = window.desirePath.clearance.toSolid(solid, px, py);
      if (metres >= radius) continue;
      if (metres <= 0) return [x, y];
      const [dx, dy] = [px - at[0], py - at[1]];
      const away = Math.hypot(dx, dy);
      [px, py] = [at[0] + (dx / away) * radius, at[1] + (dy / away) * radius];
    }
    const clear = ground.solids.every((solid) => window.desirePath.clearance.toSolid(solid, px, py).metres > radius - 0.01);
    return clear ? [px, py] : [x, y];
  }

  /** As near to there as walls let the person, in short steps. @param {number} px @param {number} py */
  function follow(px, py) {
    const count = Math.ceil(Math.hypot(px - x, py - y) / SHORT_M);
    for (let k = 0; k < count; k += 1) {
      const left = count - k;
      [x, y] = slid(x + (px - x) / left, y + (py - y) / left);
    }
  }

  /** @param {number[]} robot x, y @returns {number} metres between its edge and the person's */
  const gap = (robot) =>
    ground ? Math.hypot(x - robot[0], y - robot[1]) - ground.robot_radius - ground.person.radius : Infinity;

  /** One step of STEP_S. @param {number} yaw @param {number[]} robot where it is meanwhile */
  function step(yaw, robot) {
    const ahead = Math.max(-1, Math.min(1, is("forward") - is("back") + push[1]));
    const left = Math.max(-1, Math.min(1, is("left") - is("right") - push[0]));
    const size = Math.max(1, Math.hypot(ahead, left));
    const wanted = [(ahead / size) * (ahead > 0 ? FORWARD_M_S : ASIDE_M_S), (left / size) * ASIDE_M_S];
    going = going.map((speed, i) => speed + (wanted[i] - speed) * Math.min(1, STEP_S / EASE_S));
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const from = [x, y];
    const before = gap(robot);
    [x, y] = slid(x + (c * going[0] - s * going[1]) * STEP_S, y + (s * going[0] + c * going[1]) * STEP_S);
    if (gap(robot) < BEFORE_ROBOT_M && gap(robot) < before) [x, y] = from;
  }

  window.desirePath.walk = {
    /** What `key` takes, letters in lower case. */
    KEYS: Object.keys(KEYS),

    /** @param {Surroundings} given where the person stands, and what around them */
    begin(given) {
      ground = given;
      [x, y] = [given.person.x, given.person.y];
      [going, steps, times, poses, led] = [[0, 0], 0, [], [], null];
      window.desirePath.headset.back();
      held.clear();
      letGo();
      document.documentElement.dataset.walking = "on";
      window.desirePath.sheet.element.append(stick);
      window.desirePath.camera.walk(true);
    },

    /** The participant stands where they are. */
    stop() {
      if (!ground) return;
      ground = null;
      letGo();
      delete document.documentElement.dataset.walking;
      stick.remove();
      window.desirePath.camera.walk(false);
    },

    /**
     * On to `t` seconds since the robot began to move, which is at `robotAt`.
     * @param {number} t @param {(t: number) => number[]} robotAt
     * @returns {{x: number, y: number, yaw: number, met: boolean}} where the person is, and whether the robot touches them
     */
    advance(t, robotAt) {
      const { camera, headset } = window.desirePath;
      const head = headset.head();
      const turning = is("turnLeft") - is("turnRight");
      let yaw = head ? head.yaw : camera.heading();
      const begun = yaw;
      const due = Math.max(1, Math.floor(t / STEP_S) - steps + 1);
      const stride = head && led ? [(head.x - led[0]) / due, (head.y - led[1]) / due] : [0, 0];
      led = head && [head.x, head.y];
      const carried = [0, 0];
      let [wx, wy] = head ? [head.x - stride[0] * due, head.y - stride[1] * due] : [x, y];
      let met = false;
      for (; ground && !met && steps * STEP_S <= t; steps += 1) {
        const time = steps * STEP_S;
        if (steps > 0) {
          yaw += turning * TURN_RAD_S * STEP_S;
          [wx, wy] = [wx + stride[0], wy + stride[1]];
          if (head && (stride[0] || stride[1])) follow(wx, wy);
          const [fx, fy] = [x, y];
          step(yaw, robotAt(time));
          [wx, wy] = [wx + x - fx, wy + y - fy];
          [carried[0], carried[1]] = [carried[0] + x - fx, carried[1] + y - fy];
        }
        times.push(Math.round(time * 1e4) / 1e4);
        poses.push([x, y, yaw].map((value) => Math.round(value * 1e4) / 1e4));
        met = gap(robotAt(time)) < 0;
      }
      if (head && led) {
        headset.carry(carried);
        led = [led[0] + carried[0], led[1] + carried[1]];
      } else if (yaw !== begun) camera.turn(yaw - begun, 0);
      camera.stand(x, y);
      return { x, y, yaw, met };
    },

    /** What was walked so far. */
    recording: () => ({ times_s: times, poses }),

    /** @param {{key: string, ctrlKey?: boolean, metaKey?: boolean, altKey?: boolean}} event @param {boolean} down @returns {boolean} whether it was for the feet */
    key(event, down) {
      const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      const what = KEYS[/** @type {keyof KEYS} */ (name)];
      if (!ground || !what || event.ctrlKey || event.metaKey || event.altKey) return false;
      if (down) held.add(what);
      else held.delete(what);
      return true;
    },

    /** The stick of a controller. @param {number} right @param {number} ahead -1 to 1 */
    lean(right, ahead) {
      if (thumb === -1) push = [right, ahead];
    },

    /** How far eyes are from where the person could follow them, m. @param {number[]} eyes */
    astray: (eyes) => (ground && led ? Math.hypot(eyes[0] - x, eyes[1] - y) : 0),

    /** No key is held any more: the window was left. */
    release: () => held.clear(),
  };
})();
