// @ts-check
/**
 * The stroke on the sheet: sections drawn one after the other, undo and redo through them, and what all of it measures.
 *
 * Metres, m/s and the hand's own seconds; no pointer and no picture, which are draw.js's and ink.js's.
 */
(() => {
  "use strict";
  const SPACING_M = 0.015; // a point that is nearer to the last one says nothing new
  const WAYPOINT_SPACING_M = 0.05; // of the points between two that keys set
  const CUT_BACK_M = 0.35; // ours: so much before a place of trouble there is room to steer around it

  /**
   * @typedef {{points: number[][], speeds: number[], times: number[]}} Section
   */

  /** @type {Section[]} */
  let sections = [];
  /** Sections that undo took away, the newest last. @type {Section[][]} */
  let past = [];
  /** @type {Section[][]} */
  let future = [];
  /** The one under the pen. @type {Section | null} */
  let open = null;
  /** What the server says: how many points it takes, and what room is tight, metres. */
  let limits = { most_points: 0, tight_m: 0 };
  /** @type {number[]} */
  let start = [0, 0];
  /** When the hand's seconds began, in the events' ms; null before its first point. @type {number | null} */
  let began = null;
  /** The hand's seconds on the sheet already when it was laid out. */
  let before = 0;
  /** @type {Finds} */
  let nearest = () => ({ name: "", metres: Infinity, at: [0, 0] });
  /** Everything below is computed anew only after a change. */
  let changed = true;
  /** @type {Measured} */
  let whole = { points: [], speeds: [], nears: [], tight: [], length: 0, seconds: 0 };

  /** @param {number[]} a @param {number[]} b */
  const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

  const end = () => {
    const last = sections[sections.length - 1];
    return last ? last.points[last.points.length - 1] : start;
  };

  /** The hand's seconds at that moment. @param {number} time ms */
  function secondsAt(time) {
    began ??= time - 1000 * before;
    return (time - began) / 1000;
  }

  /** A change that undo can take back. @param {Section[]} next */
  function become(next) {
    past.push(sections);
    future = [];
    sections = next;
    changed = true;
  }

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
    whole = { points, speeds, nears, tight: window.desirePath.clearance.tight(nears, limits.tight_m), length, seconds };
    return whole;
  }

  /** Back or forth through what was drawn. @param {Section[][]} from @param {Section[][]} to @returns {boolean} whether there was any */
  function turnTo(from, to) {
    const next = from.pop();
    if (!next) return false;
    to.push(sections);
    sections = next;
    changed = true;
    return true;
  }

  window.desirePath.sections = {
    apart,
    /** Where the next section begins. */
    end,
    measure,
    any: () => sections.length > 0,
    isOpen: () => open !== null,
    canUndo: () => past.length > 0,
    canRedo: () => future.length > 0,

    /**
     * A sheet with nothing on it but what was drawn before.
     * @param {number[]} from where the robot stands @param {DrawnStroke | null} drawn
     * @param {{most_points: number, tight_m: number}} given the server's limits
     */
    begin(from, drawn, given) {
      limits = given;
      start = from;
      sections = drawn ? [{ points: drawn.points, speeds: drawn.speeds, times: drawn.times_s }] : [];
      [past, future, open, began, changed] = [[], [], null, null, true];
      before = drawn ? drawn.times_s[drawn.times_s.length - 1] : 0;
    },

    /** What is there is measured anew. @param {Finds} finds what is nearest to a robot there then */
    measureBy(finds) {
      nearest = finds;
      [whole.points, changed] = [[], true];
    },

    /** The pen is put down. */
    put() {
      open = { points: [], speeds: [], times: [] };
    },

    /** @param {number[]} point @param {number} speed @param {number} time ms */
    add(point, speed, time) {
      if (!open || whole.points.length >= limits.most_points) return;
      const last = open.points[open.points.length - 1];
      if (last && apart(point, last) < SPACING_M) return;
      open.points.push(point);
      open.speeds.push(speed);
      open.times.push(secondsAt(time));
      changed = true;
    },

    /** The pen is lifted. @returns {boolean} whether a section was drawn */
    lift() {
      const section = open;
      this.drop();
      if (!section || section.points.length < 2) return false;
      become([...sections, section]);
      return true;
    },

    /** What is under the pen is not drawn. */
    drop() {
      [open, changed] = [null, true];
    },

    /** A straight section to there. @param {number[]} to @param {number} speed @param {number} time ms @returns {boolean} whether it is one */
    straightTo(to, speed, time) {
      const from = end();
      const count = Math.max(1, Math.round(apart(from, to) / WAYPOINT_SPACING_M));
      if (apart(from, to) < SPACING_M) return false;
      /** @type {Section} */
      const section = { points: [], speeds: [], times: [] };
      for (let k = sections.length ? 1 : 0; k <= count; k += 1) {
        section.points.push([from[0] + ((to[0] - from[0]) * k) / count, from[1] + ((to[1] - from[1]) * k) / count]);
        section.speeds.push(speed);
        section.times.push(secondsAt(time));
      }
      become([...sections, section]);
      return true;
    },

    undo: () => turnTo(past, future),
    redo: () => turnTo(future, past),

    clear() {
      if (sections.length) become([]);
    },

    /** Ends the stroke shortly before a place, so that the good part need not be drawn again. @param {number[]} at */
    cutBefore(at) {
      const { points } = measure();
      let hit = points.reduce((best, point, i) => (apart(point, at) < apart(points[best], at) ? i : best), 0);
      for (let back = 0; hit > 0 && back < CUT_BACK_M; hit -= 1) back += apart(points[hit], points[hit - 1]);
      let left = hit + 1;
      const kept = sections.flatMap((section) => {
        const count = Math.min(left, section.points.length);
        left -= count;
        if (count === 0) return [];
        const cut = (/** @type {any[]} */ values) => values.slice(0, count);
        return [{ points: cut(section.points), speeds: cut(section.speeds), times: cut(section.times) }];
      });
      become(kept.flatMap((section) => section.points).length < 2 ? [] : kept);
    },

    /** All of it as one stroke. @returns {DrawnStroke} */
    stroke() {
      const round = (/** @type {number} */ value) => Math.round(value * 1e4) / 1e4;
      return {
        points: sections.flatMap((section) => section.points.map((point) => point.map(round))),
        speeds: sections.flatMap((section) => section.speeds.map(round)),
        times_s: sections.flatMap((section) => section.times.map((value) => Math.round(value * 1e3) / 1e3)),
      };
    },
  };
})();
