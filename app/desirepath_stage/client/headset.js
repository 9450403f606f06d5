// @ts-check
/**
 * Entering the room with a headset (WebXR) and leaving it: who wears one stands where the scene's person stands, floor at
 * floor height, eyes as high as their own, the robot's start straight ahead as in the window. Nothing moves them but a
 * change of scene, in the dark. What a panel says and what its buttons do is the page's, sent as `{type: "headset", do}`:
 * `offer` (words; required or not), `panel`, `off` (the room has nothing more to show).
 */
(() => {
  "use strict";
  const { bridge, viser, frames, headPose, headsetRoom: room, headsetHands: hands, headsetFloor: floor } = window.desirePath;
  const DWELL_S = 1.5; // who looks at a button for so long, without hands, presses it
  const FADE_S = 0.35;
  const HIDDEN_MS = 3000; // off the head for so long, the session ends and it goes on in the window
  const NARROW_S = 0.2; // until the sight is narrow, or wide again
  const [IN_WALL_M, WALL_M] = [0.1, 0.25]; // so deep in a wall it begins to be dark, and is after so much more
  const SLOW = 1.5; // a picture that comes after so many times the headset's own pace came late

  /** @type {any} XRSession */
  let session = null;
  /** As the headset tells it, before it is turned and shifted into the scene. @type {any} XRReferenceSpace */
  let ground = null;
  /** @type {Orders["camera"] | null} */
  let camera = null;
  let square = "";
  /** @type {Record<string, string> | null} */
  let words = null;
  let asked = false; // for a headset, by the study
  let supported = false;
  let required = false;
  /** Why no headset is worn, as page.py lists it. @type {string | null} */
  let refused = null;
  let entering = false;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let hidden;
  let built = false; // what stands in the room for who wears it; its scene may be on its way
  let placed = false;
  let dark = 1;
  let narrow = 0;
  let last = 0;
  /** How the ground is turned and where the head is on it, and where in the scene: what was shifted last. */
  let turnedBy = 0;
  /** @type {{raw: {x: number, z: number}, eyes: number[], yaw: number} | null} */
  let head = null;
  /** What makes being moved bearable, unless one does without. */
  let comfort = { snap: true, narrow: true };
  let dwell = { id: "", since: 0, spent: "" };
  /** The gaps between pictures since `count` was asked to begin, ms. */
  let gaps = { frames: 0, dropped: 0, sum: 0 };
  /** What was pointed with since then. @type {Set<string>} */
  let pointing = new Set();
  /** Rays of the newest picture, by the input that has them. @type {Map<any, {from: number[], along: number[], held: boolean}>} */
  let rays = new Map();

  const button = document.createElement("button");
  Object.assign(button, { id: "desire-path-headset", type: "button", hidden: true });
  window.desirePath.sheet.element.append(button);
  button.addEventListener("pointerdown", (event) => event.stopPropagation()); // beside it the gaze is turned
  button.addEventListener("click", () => void enter());

  const xr = () => /** @type {any} */ (navigator).xr;

  /** Why no headset can be worn here, null: it can. @returns {Promise<string | null>} */
  async function against() {
    const policy = /** @type {any} */ (document).featurePolicy;
    if (policy?.features().includes("xr-spatial-tracking") && !policy.allowsFeature("xr-spatial-tracking")) return "blocked";
    if (!window.isSecureContext) return "insecure";
    if (!xr()) return "browser";
    try {
      return (await xr().isSessionSupported("immersive-vr")) ? null : "missing";
    } catch {
      return "blocked"; // a Permissions-Policy of the page or the frame's `allow`
    }
  }

  async function offer() {
    refused = await against();
    supported = refused === null;
    show();
  }

  const here = () => camera?.view === "immersive" && square !== "";

  /** Shows the button where a headset can be put on, and tells the page how things stand. */
  function show() {
    if (!asked) return;
    button.hidden = !(words && supported && !session && here());
    button.textContent = words?.enter ?? "";
    bridge.post("headset", { on: session !== null, here: here(), why: refused, ...told() });
  }

  async function enter() {
    if (session || entering || !words) return;
    entering = true;
    refused = null;
    try {
      const opened = await xr().requestSession("immersive-vr", {
        requiredFeatures: ["local-floor"], optionalFeatures: ["hand-tracking"],
      });
      await begin(opened).catch((error) => {
        void opened.end();
        throw error;
      });
    } catch (error) {
      const denied = error instanceof DOMException && ["NotAllowedError", "SecurityError"].includes(error.name);
      refused = denied ? "denied" : "failed";
    } finally {
      entering = false;
      show();
    }
  }

  /** @param {any} opened XRSession */
  async function begin(opened) {
    const { gl } = viser.drawing();
    viser.wear(window.desirePath.scheme.isDark() ? [0.086, 0.078, 0.059] : [0.875, 0.898, 0.902]);
    opened.addEventListener("end", end);
    opened.addEventListener("selectstart", (/** @type {any} */ { inputSource }) => hands.down(inputSource, rays.get(inputSource)));
    opened.addEventListener("selectend", (/** @type {any} */ { inputSource }) => hands.up(inputSource));
    opened.addEventListener("select", (/** @type {any} */ { inputSource }) => {
      if (!hands.takes(inputSource)) press(rays.get(inputSource));
    });
    opened.addEventListener("visibilitychange", () => {
      hands.release();
      window.desirePath.player.interrupt("tab-hidden"); // also as it is put on again: nobody saw what was between
      clearTimeout(hidden);
      if (opened.visibilityState === "hidden") hidden = setTimeout(() => void opened.end(), HIDDEN_MS);
    });
    gl.xr.setReferenceSpaceType("local-floor");
    gl.xr.setFoveation(1);
    await gl.xr.setSession(opened);
    ground = await opened.requestReferenceSpace("local-floor");
    session = opened;
    [built, placed, dark, narrow, rays, last, head] = [false, false, 1, 0, new Map(), 0, null];
    window.desirePath.player.interrupt("headset");
    headPose.begin();
    frames.use(opened);
    document.documentElement.dataset.headset = "on";
    opened.requestAnimationFrame(picture);
  }

  /** The headset was taken off, its battery is empty, or the room is left: it goes on in the window. */
  function end() {
    clearTimeout(hidden);
    headPose.flush();
    hands.release();
    viser.wear(null);
    room.clear();
    floor.lift();
    frames.use(null);
    if (!session) return; // it ended before it stood
    session = ground = head = null;
    built = false;
    delete document.documentElement.dataset.headset;
    window.desirePath.player.interrupt("headset");
    window.desirePath.camera.fit();
    show();
  }

  /** The inputs' own names, which the browser tells; it does not tell which headset it is. */
  function told() {
    const sources = [...(session?.inputSources ?? [])];
    return {
      controllers: [...new Set(sources.map((source) => String(source.profiles?.[0] ?? source.targetRayMode).slice(0, 60)))].slice(0, 4),
      refresh_rate: Number(session?.frameRate) || null,
    };
  }

  /** Where the scene's person stands, and straight ahead where the robot starts. @param {any} pose in `ground` */
  function place(pose) {
    if (!camera) return;
    const [x, y] = camera.eye;
    const ahead = viser.toView([camera.target[0] - x, camera.target[1] - y, 0]);
    const look = turned(pose.transform.orientation, [0, 0, -1]);
    const by = Math.atan2(-ahead[0], -ahead[2]) - Math.atan2(-look[0], -look[2]);
    settle(by, pose.transform.position, [x, y]);
    placed = true;
  }

  /** Turns and shifts the ground so that the head is there. @param {number} by rad @param {{x: number, z: number}} raw the head on it @param {number[]} there x, y in the scene */
  function settle(by, raw, there) {
    turnedBy = by;
    const at = viser.toView([there[0], there[1], 0]);
    const [c, s] = [Math.cos(by), Math.sin(by)];
    const shift = { x: at[0] - (c * raw.x + s * raw.z), y: at[1], z: at[2] - (c * raw.z - s * raw.x) };
    const XRRigidTransform = /** @type {any} */ (window).XRRigidTransform;
    const into = new XRRigidTransform(shift, { x: 0, y: Math.sin(by / 2), z: 0, w: Math.cos(by / 2) });
    viser.drawing().gl.xr.setReferenceSpace(ground.getOffsetReferenceSpace(into.inverse));
  }

  /** What is around the eyes while one moves: dark in a wall, narrow while a stick moves one. @param {{from: number[], along: number[]}} eyes @param {number} seconds */
  function surround(eyes, seconds) {
    const { turn, moves } = hands.sticks([...session.inputSources], seconds, comfort.snap);
    if (turn && head) settle(turnedBy + turn, head.raw, head.eyes);
    const more = moves && comfort.narrow ? 1 : -1;
    narrow = Math.max(0, Math.min(1, narrow + (more * seconds) / NARROW_S));
    room.narrow(eyes.from, eyes.along, narrow);
    return Math.max(0, Math.min(1, (window.desirePath.walk.astray(eyes.from) - IN_WALL_M) / WALL_M));
  }

  /** @param {{x: number, y: number, z: number, w: number}} q @param {number[]} v @returns {number[]} */
  function turned({ x, y, z, w }, [a, b, c]) {
    const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
  }

  /** Where something is and whither it points, in the scene's metres. @param {any} transform @returns {{from: number[], along: number[]}} */
  function ray({ position: { x, y, z }, orientation }) {
    return { from: viser.fromView([x, y, z]), along: viser.fromView(turned(orientation, [0, 0, -1])) };
  }

  /** @param {number} time @param {any} frame XRFrame */
  function picture(time, frame) {
    if (!session || frame.session !== session) return;
    session.requestAnimationFrame(picture);
    const gap = last ? time - last : 0;
    last = time;
    count(gap);
    const { gl } = viser.drawing();
    const raw = frame.getViewerPose(ground);
    const standing = bridge.state.ready;
    if (!built && standing && (built = room.build(square)) && camera) floor.lay(camera);
    if (raw && !placed && standing) place(raw);
    const pose = frame.getViewerPose(gl.xr.getReferenceSpace());
    if (!pose) return;
    if (placed) headPose.see(pose.transform, (axis) => turned(pose.transform.orientation, axis));
    const eyes = ray(pose.transform);
    if (raw) head = { raw: raw.transform.position, eyes: eyes.from, yaw: Math.atan2(eyes.along[1], eyes.along[0]) };
    rays = new Map();
    for (const source of session.inputSources) {
      const aimed = source.targetRayMode === "tracked-pointer" && frame.getPose(source.targetRaySpace, gl.xr.getReferenceSpace());
      if (aimed) rays.set(source, { ...ray(aimed.transform), held: true });
    }
    const held = [...rays.values()];
    const gazing = held.length === 0;
    pointing.add(gazing ? "gaze" : [...session.inputSources].some((source) => source.hand) ? "hand" : "controller");
    if (gazing) for (const source of session.inputSources) rays.set(source, { ...eyes, held: false });
    dark = Math.max(0, Math.min(1, dark + ((placed && standing ? -1 : 1) * gap) / 1000 / FADE_S));
    if (!built) return;
    hands.move(rays);
    const shut = surround(eyes, Math.min(0.1, gap / 1000));
    const aimed = window.desirePath.draw.waits() ? held.map((one) => ({ ...one, floor: hands.floorUnder(one) })) : held;
    const found = room.draw(eyes.from, eyes.along, gazing ? [{ ...eyes, held: false }] : aimed, Math.max(dark, shut));
    const halted = window.desirePath.explained.halt();
    room.label(eyes.from, [...window.desirePath.picking.labels(held), ...(halted ? [halted] : [])]);
    floor.draw();
    room.find(eyes.from, eyes.along, window.desirePath.camera.watched());
    look(found, gazing, time);
  }

  /** A look at a button for long enough presses it, where there are no hands. @param {string[]} ids @param {boolean} gazing @param {number} time */
  function look(ids, gazing, time) {
    const id = ids[0] ?? "";
    if (id !== dwell.id) dwell = { id, since: time, spent: "" };
    const share = gazing && id && dwell.spent !== id ? (time - dwell.since) / 1000 / DWELL_S : 0;
    room.point(ids, Math.min(1, share));
    if (share < 1) return;
    dwell.spent = id;
    pressed(id);
  }

  /** @param {{from: number[], along: number[]} | undefined} aimed */
  function press(aimed) {
    const on = aimed && room.meet(aimed.from, aimed.along)?.button;
    if (on && !on.resting && !on.slides) pressed(on.id);
  }

  /** @param {string} id */
  function pressed(id) {
    if (id === "leave") session?.end();
    else bridge.post("headset-press", { id, headset: window.desirePath.headset.report() });
  }

  /** @param {number} gap ms since the picture before */
  function count(gap) {
    if (!gap) return;
    const pace = 1000 / (Number(session.frameRate) || 72);
    gaps.frames += 1;
    gaps.sum += gap;
    if (gap > SLOW * pace) gaps.dropped += Math.round(gap / pace) - 1;
  }

  window.desirePath.headset = {
    /** Another scene stands. @param {Orders["camera"]} next @param {string[]} meshes */
    use(next, meshes) {
      headPose.flush();
      camera = next;
      square = meshes.find((name) => name.endsWith("/square")) ?? "";
      placed = false;
      if (built) {
        window.desirePath.quads.use(square); // the one of before goes with its scene
        floor.lay(next);
      }
      if (session && next.view !== "immersive") session.end();
      show();
    },

    worn: () => session !== null,
    /** Whether nothing in the window counts here. */
    needed: () => required && here() && !session,

    /** Where the head is, as the newest picture had it; null in the window. */
    head: () => (session && placed && head ? { x: head.eyes[0], y: head.eyes[1], yaw: head.yaw } : null),

    /** A stick moves who wears it. @param {number[]} by x, y, m */
    carry([dx, dy]) {
      if (!head || (!dx && !dy)) return;
      head.eyes = [head.eyes[0] + dx, head.eyes[1] + dy, head.eyes[2]];
      settle(turnedBy, head.raw, head.eyes);
    },

    /** Back to the person's place, in the dark: a walk begins there. */
    back() {
      if (session) [placed, dark] = [false, 1];
    },

    /** From now on it is counted how the pictures come. */
    begin() {
      gaps = { frames: 0, dropped: 0, sum: 0 };
      pointing = new Set();
    },

    /** What is stored beside what was watched in the headset since `begin`; null in the window. */
    report() {
      if (!session) return null;
      return { ...told(), frames: gaps.frames, dropped: gaps.dropped, pointing: [...pointing].sort() };
    },

    /** @param {any} message from the page */
    obey(message) {
      if (message.do === "offer") {
        [words, asked] = [message.words, true]; // none: what is shown now is for the window
        headPose.ask(message.head_pose === true);
        required = Boolean(message.required);
        void offer();
      } else if (message.do === "panel") {
        room.show(message.panel);
      } else if (message.do === "comfort") {
        comfort = { snap: Boolean(message.snap), narrow: Boolean(message.narrow) };
      } else if (message.do === "leave") session?.end();
    },
  };
})();
