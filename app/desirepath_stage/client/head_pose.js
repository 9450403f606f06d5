// @ts-check
/**
 * How the head moves in a headset, RATE_HZ times a second, where the page asks for it: where it is and which way it faces
 * in the scene's frame, in parts of a few seconds, which the page sends on. What plays begins a part of its own.
 */
(() => {
  "use strict";
  const { bridge, viser } = window.desirePath;
  const RATE_HZ = 30;
  const PART = 150; // poses
  const GAP_MS = 1000; // after which a part ends: nothing was seen meanwhile

  let asked = false;
  let wearing = "";
  let part = 0;
  let putOn = 0; // when, ms, as all that follows
  let first = 0;
  let due = 0;
  let newest = 0;
  let movesAt = 0; // the robot that plays, for the first time
  /** @type {string | null} */
  let playing = null;
  /** @type {number[]} */
  let times = [];
  /** @type {number[][]} */
  let poses = [];

  const rounded = (/** @type {number} */ value) => Math.round(value * 1e4) / 1e4;

  /** Columns are where x ahead, y to the left and z up lie. @param {number[][]} axes @returns {number[]} unit quaternion x, y, z, w */
  function quaternion([[a, d, g], [b, e, h], [c, f, i]]) {
    // the largest of the four first, so that nothing small is divided by
    const squares = [1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i];
    const k = squares.indexOf(Math.max(...squares));
    const s = 2 * Math.sqrt(squares[k]);
    const found = [
      [s / 4, (b + d) / s, (c + g) / s, (h - f) / s],
      [(b + d) / s, s / 4, (f + h) / s, (c - g) / s],
      [(c + g) / s, (f + h) / s, s / 4, (d - b) / s],
      [(h - f) / s, (c - g) / s, (d - b) / s, s / 4],
    ][k];
    return found;
  }

  /** Sends what is there. */
  function flush() {
    if (times.length) {
      const head = {
        wearing, part, began_s: rounded((first - putOn) / 1000), times_s: times, poses,
        playback_id: playing, playing_s: playing === null ? null : rounded((first - movesAt) / 1000),
      };
      bridge.post("head", { head });
      part += 1;
    }
    [times, poses] = [[], []];
  }

  window.desirePath.headPose = {
    /** @param {boolean} wanted whether the study stores it */
    ask(wanted) {
      asked = wanted;
    },

    /** The headset was put on. */
    begin() {
      const bytes = crypto.getRandomValues(new Uint8Array(12));
      wearing = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
      [part, putOn, due, times, poses] = [0, performance.now(), 0, [], []];
    },

    /** What plays begins to move then. @param {number} at ms */
    moves(at) {
      flush();
      movesAt = at;
    },

    flush,

    /** @param {any} transform XRRigidTransform of the eyes in what is drawn @param {(along: number[]) => number[]} turned by its orientation */
    see({ position: { x, y, z } }, turned) {
      const now = performance.now();
      if (!asked || now < due) return;
      due = Math.max(due + 1000 / RATE_HZ, now - 1000 / RATE_HZ); // a late picture is not made up for
      const id = bridge.state.playback_id;
      if (id !== playing || times.length >= PART || now - newest > GAP_MS) flush();
      newest = now;
      if (!times.length) [first, playing] = [now, id];
      const axes = [[0, 0, -1], [-1, 0, 0], [0, 1, 0]].map((axis) => viser.fromView(turned(axis)));
      times.push(rounded((now - first) / 1000));
      poses.push([...viser.fromView([x, y, z]), ...quaternion(axes)].map(rounded));
    },
  };
})();
