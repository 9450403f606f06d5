// @ts-check
/** The next picture: the window's or, while a headset is worn, the headset's, where the window may draw none. */
(() => {
  "use strict";
  /** What waits for the next picture. @type {Set<() => void>} */
  let waiting = new Set();
  /** @type {any} the session of a headset, an XRSession */
  let worn = null;
  let asked = false;

  function ask() {
    if (asked) return;
    asked = true;
    const from = worn;
    const draw = () => {
      if (from !== worn) return; // the headset was put on or taken off meanwhile: `use` asked anew
      asked = false;
      const due = waiting;
      waiting = new Set();
      for (const one of due) one();
    };
    if (from) from.requestAnimationFrame(draw);
    else requestAnimationFrame(draw);
  }

  window.desirePath.frames = {
    /** @param {() => void} action once, with the next picture */
    next(action) {
      waiting.add(action);
      ask();
    },

    /** @param {any} session of the headset that is worn from now on, null: the window */
    use(session) {
      worn = session;
      asked = false;
      if (waiting.size) ask();
    },
  };
})();
