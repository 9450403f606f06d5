// @ts-check
/**
 * The sheet over viser's canvas: it takes every pointer and key before viser can, shows the label and, in a strip above
 * the picture, legends, and turns the gaze where it may be turned. Nothing reaches viser's own controls but the analyst's
 * free camera.
 */
(() => {
  "use strict";
  const { bridge } = window.desirePath;
  const RADIANS_PER_WINDOW_HEIGHT = 1.4; // a drag over the whole height turns the head by 80 degrees
  const KEY_RADIANS_PER_S = 1.4;
  const APART_PX = 16; // of what lies at the window's edge
  const FREE_PX = 56; // from the middle of a robot or a person to what lies beside it
  const ARROWS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

  const sheet = document.createElement("div");
  sheet.id = "desire-path-sheet";
  sheet.tabIndex = -1;
  const label = document.createElement("div");
  label.id = "desire-path-label";
  label.hidden = true;
  const letter = document.createElement("span");
  label.append(letter);
  const legend = document.createElement("ul");
  legend.id = "desire-path-legend";
  legend.hidden = true;
  const strip = document.createElement("div");
  strip.id = "desire-path-strip";
  strip.append(legend);
  sheet.append(label, strip);
  new ResizeObserver(() => window.desirePath.camera?.fit()).observe(strip);
  document.addEventListener("DOMContentLoaded", () => document.body.append(sheet));

  /** @type {Set<string>} */
  const held = new Set();
  /** @type {{id: number, x: number, y: number} | null} */
  let drag = null;
  let lastKeyStep = 0;

  const mayLook = () => window.desirePath.camera.mayTurn();

  sheet.addEventListener("pointerdown", (event) => {
    sheet.focus({ preventScroll: true });
    if (window.desirePath.draw.press(event) || !mayLook() || drag) return;
    drag = { id: event.pointerId, x: event.clientX, y: event.clientY };
    sheet.setPointerCapture(event.pointerId);
    sheet.dataset.looking = "";
  });
  sheet.addEventListener("pointermove", (event) => {
    if (drag?.id !== event.pointerId) return;
    const scale = RADIANS_PER_WINDOW_HEIGHT / window.innerHeight;
    window.desirePath.camera.turn((event.clientX - drag.x) * scale, (event.clientY - drag.y) * scale);
    drag = { id: event.pointerId, x: event.clientX, y: event.clientY };
  });
  for (const type of ["pointerup", "pointercancel"]) {
    sheet.addEventListener(type, (event) => {
      if (drag?.id !== /** @type {PointerEvent} */ (event).pointerId) return;
      drag = null;
      delete sheet.dataset.looking;
    });
  }
  for (const type of ["wheel", "contextmenu", "touchstart", "touchmove", "dragstart"]) {
    sheet.addEventListener(type, (event) => event.preventDefault(), { passive: false });
  }

  function turnByKeys() {
    const now = performance.now();
    const seconds = Math.min(0.1, (now - lastKeyStep) / 1000);
    lastKeyStep = now;
    let yaw = 0;
    let pitch = 0;
    for (const key of held) {
      const [left, up] = ARROWS[/** @type {keyof ARROWS} */ (key)];
      yaw += left;
      pitch += up;
    }
    window.desirePath.camera.turn(yaw * KEY_RADIANS_PER_S * seconds, pitch * KEY_RADIANS_PER_S * seconds);
    if (held.size && mayLook()) requestAnimationFrame(turnByKeys);
  }

  window.addEventListener("keydown", (event) => {
    event.stopImmediatePropagation();
    if (window.desirePath.walk.key(event, true) || window.desirePath.draw.key(event)) {
      event.preventDefault();
      return;
    }
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in ARROWS) {
      event.preventDefault();
      if (!mayLook() || held.has(event.key)) return;
      held.add(event.key);
      if (held.size === 1) {
        lastKeyStep = performance.now();
        requestAnimationFrame(turnByKeys);
      }
    } else if (!event.repeat && (event.key.length === 1 || event.key === "Enter" || event.key === "Escape")) {
      bridge.post("key", { key: event.key }); // the page answers A and B even while the stage has the focus
    }
  }, true);
  window.addEventListener("keyup", (event) => {
    event.stopImmediatePropagation();
    window.desirePath.walk.key(event, false);
    held.delete(event.key);
  }, true);
  window.addEventListener("keypress", (event) => event.stopImmediatePropagation(), true);
  window.addEventListener("blur", () => {
    held.clear();
    window.desirePath.walk.release();
  });

  /** The first place at the window's edge that is free of these pixels, or the one farthest from them. @param {HTMLElement} element @param {number[][]} taken */
  function place(element, taken) {
    const { width, height } = element.getBoundingClientRect();
    const [right, bottom, top] = [window.innerWidth - width - APART_PX, window.innerHeight - height - APART_PX, strip.offsetHeight + APART_PX];
    const [centre, middle] = [(APART_PX + right) / 2, (top + bottom) / 2];
    const spots = [[APART_PX, top], [right, top], [APART_PX, bottom], [right, bottom], [centre, top], [centre, bottom], [APART_PX, middle], [right, middle]];
    const room = (/** @type {number[]} */ [x, y]) => Math.min(Infinity, ...taken.map(([px, py]) =>
      Math.hypot(Math.max(x - px, 0, px - x - width), Math.max(y - py, 0, py - y - height))));
    const [x, y] = spots.find((spot) => room(spot) > FREE_PX) ?? spots.reduce((a, b) => (room(b) > room(a) ? b : a));
    element.style.transform = `translate(${x}px, ${y}px)`;
  }

  window.desirePath.sheet = {
    /** Where other scripts of ours put what they show. */
    element: sheet,
    /** Where they put legends: above the picture, which begins under it. */
    strip,
    /** How much of the window's upper edge is no picture, pixels. */
    covered: () => strip.offsetHeight,
    /** @param {string} text "" hides the label @param {number[][]} [keeps] places on the floor that it must not cover */
    label(text, keeps = []) {
      label.hidden = text === "";
      if (letter.textContent !== text) letter.textContent = text;
      if (text === "") return;
      const settle = () => {
        const project = window.desirePath.viser.projector();
        place(label, keeps.flatMap(([x, y]) => [0, 0.4].flatMap((z) => [project(x, y, z) ?? []])).filter((at) => at.length));
      };
      settle();
      requestAnimationFrame(settle); // a gaze that was turned back is back then
    },
    /** @param {{name: string, colour: number[], hollow?: boolean}[]} entries */
    legend(entries) {
      window.desirePath.headsetRoom?.legend(entries);
      legend.hidden = entries.length === 0;
      legend.replaceChildren(...entries.map(({ name, colour, hollow }) => {
        const item = document.createElement("li");
        const dot = document.createElement("i");
        if (hollow) dot.style.boxShadow = `inset 0 0 0 3px rgb(${colour.join(",")})`;
        else dot.style.background = `rgb(${colour.join(",")})`;
        item.append(dot, name);
        return item;
      }));
    },
  };
})();
