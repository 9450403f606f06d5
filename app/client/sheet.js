// @ts-check
/**
 * The sheet over viser's canvas: it takes every pointer and key before viser can, shows the label and the legend,
 * and turns the gaze where it may be turned. Nothing reaches viser's own controls but the analyst's free camera.
 */
(() => {
  "use strict";
  const { bridge } = window.desirePath;
  const RADIANS_PER_WINDOW_HEIGHT = 1.4; // a drag over the whole height turns the head by 80 degrees
  const KEY_RADIANS_PER_S = 1.4;
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
  sheet.append(label, legend);
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

  window.desirePath.sheet = {
    /** Where other scripts of ours put what they show. */
    element: sheet,
    /** @param {string} text "" hides the label */
    label(text) {
      label.hidden = text === "";
      if (letter.textContent !== text) letter.textContent = text;
    },
    /** @param {{name: string, colour: number[], hollow?: boolean}[]} entries */
    legend(entries) {
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
