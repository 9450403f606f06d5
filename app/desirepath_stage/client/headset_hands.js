// @ts-check
/**
 * What hands do with a headset: a trigger or pinch that is held is the pen pressed to the floor (draw.js) or a slider's knob
 * held; one pressed at a thing in the room picks it; sticks walk and turn. Buttons are headset.js's.
 */
(() => {
  "use strict";
  const { bridge, draw, headsetRoom: room } = window.desirePath;
  const REACH_M = 15; // of a ray over the floor
  const SLIDES_EVERY_MS = 100;
  const [STILL, TURNS, TURNS_BACK] = [0.15, 0.7, 0.4]; // how far a stick is leant
  const SNAP_RAD = Math.PI / 6;
  const TURN_RAD_S = 1.2;
  const CALM_MS = 40; // a hand trembles: what it points at is followed with so much delay

  /** The input that has the pen, and where it was, calmed. @type {{source: any, at: number[], time: number} | null} */
  let pen = null;
  /** The input that holds a knob, whose, where it was told last. @type {{source: any, id: string, share: number, at: number} | null} */
  let knob = null;
  /** Inputs whose press is no press of a button. @type {Set<any>} */
  let taken = new Set();
  /** The stick to the side has turned, and has to come back first. */
  let turned = false;
  let faster = false;

  /** @param {{from: number[], along: number[]}} ray @returns {number[] | null} */
  function floorUnder({ from, along }) {
    if (along[2] > -1e-6) return null;
    const reach = -from[2] / along[2];
    return reach * Math.hypot(along[0], along[1]) > REACH_M ? null : [from[0] + reach * along[0], from[1] + reach * along[1]];
  }

  /** @param {any} source */
  const kind = (source) => (source.hand ? "hand" : source.targetRayMode === "tracked-pointer" ? "controller" : "gaze");

  /** @param {boolean} settled the hand has let go */
  function tellKnob(settled) {
    if (!knob) return;
    knob.at = performance.now();
    bridge.post("headset-press", { id: knob.id, share: knob.share, settled });
  }

  /** @param {RoomRay} ray of the hand that has the pen */
  function follow(ray) {
    const found = floorUnder(ray);
    if (!found || !pen) return;
    const now = performance.now();
    const share = 1 - Math.exp((pen.time - now) / CALM_MS);
    pen.at = pen.at.map((value, i) => value + share * (found[i] - value));
    pen.time = now;
    draw.hand.move(pen.at);
  }

  function lift() {
    if (!pen) return;
    pen = null;
    draw.hand.lift();
  }

  window.desirePath.headsetHands = {
    floorUnder,

    /** A trigger or pinch begins. @param {any} source @param {RoomRay | undefined} ray */
    down(source, ray) {
      taken.delete(source);
      if (!ray) return;
      const hit = room.meet(ray.from, ray.along);
      if (hit) {
        if (!hit.button?.slides || hit.button.resting || knob) return;
        knob = { source, id: hit.button.id, share: hit.share, at: 0 };
        taken.add(source);
        return;
      }
      const floor = floorUnder(ray);
      if (window.desirePath.picking.press(ray.from, ray.along)) taken.add(source);
      else if (floor && !pen && draw.waits() && draw.hand.put(floor, kind(source))) {
        pen = { source, at: floor, time: performance.now() };
        taken.add(source);
      } else if (floor) window.desirePath.mirror.press(floor);
    },

    /** It ends. @param {any} source */
    up(source) {
      taken.delete(source);
      if (pen?.source === source) lift();
      if (knob?.source !== source) return;
      tellKnob(true);
      knob = null;
    },

    /** Whether this press was for something else than a button. @param {any} source */
    takes: (source) => taken.has(source),

    /** One picture. @param {Map<any, RoomRay>} rays of the inputs that are there */
    move(rays) {
      const drawing = pen && rays.get(pen.source);
      if (drawing) follow(drawing);
      else lift(); // nothing is held, or it was switched off, or its tracking lost
      if (!knob) return;
      const ray = rays.get(knob.source);
      const hit = ray && room.meet(ray.from, ray.along);
      if (hit?.button?.id === knob.id) knob.share = hit.share;
      if (!ray) {
        tellKnob(true);
        knob = null;
      } else if (performance.now() - knob.at > SLIDES_EVERY_MS) tellKnob(false);
    },

    /** The headset is off the head, or was taken off: nothing is held. */
    release() {
      lift();
      if (knob) tellKnob(true);
      knob = null;
      taken.clear();
      window.desirePath.walk.lean(0, 0);
    },

    /**
     * What the sticks say. @param {any[]} sources @param {number} seconds since the picture before @param {boolean} snaps turns in steps
     * @returns {{turn: number, moves: boolean}} by how much to turn to the left, rad; whether one is moved, smoothly
     */
    sticks(sources, seconds, snaps) {
      let [aside, ahead, turn, nudge] = [0, 0, 0, 0];
      for (const source of sources) {
        const axes = source.gamepad?.axes ?? [];
        const [x, y] = axes.length > 3 ? [axes[2], axes[3]] : [axes[0] ?? 0, axes[1] ?? 0];
        if (Math.abs(y) > STILL) [ahead, nudge] = [-y, -y];
        if (Math.abs(x) <= STILL) continue;
        if (source.handedness === "left") aside = x;
        else turn = -x;
      }
      const may = document.documentElement.dataset.walking === "on";
      window.desirePath.walk.lean(may ? aside : 0, may ? ahead : 0);
      if (!may && draw.waits() && Math.abs(nudge) > TURNS !== faster) {
        faster = !faster;
        if (faster) draw.hand.faster(Math.sign(nudge));
      }
      if (!may) return { turn: 0, moves: false };
      if (!snaps) return { turn: turn * TURN_RAD_S * seconds, moves: Boolean(aside || ahead || turn) };
      const steps = !turned && Math.abs(turn) > TURNS;
      turned = Math.abs(turn) > (turned ? TURNS_BACK : TURNS);
      return { turn: steps ? Math.sign(turn) * SNAP_RAD : 0, moves: Boolean(aside || ahead) };
    },
  };
})();
