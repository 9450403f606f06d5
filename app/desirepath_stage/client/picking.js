// @ts-check
/**
 * Objects in the room that can be picked one after the other: a name over each, with its place in the ranking once it
 * has one. Which place that is, the page says; here a click or a touch becomes the object under it.
 *
 * What this shows is the list on the page once more, so it is hidden from screen readers, which have the list.
 */
(() => {
  "use strict";
  const { bridge, viser } = window.desirePath;
  const STILL_PX = 8; // a press that moves farther turns the head
  const ABOVE_PX = 5;
  const SHARES = [-1, -0.5, 0, 0.5, 1]; // of half a side, from its middle
  const LEAST_SEEN = 0.02; // of a thing's surface: an edge behind a column is not the thing

  /** @typedef {ReturnType<DesirePath["explained"]["objects"]>[number]} Thing */

  /** @type {{thing: Thing, tag: HTMLElement, place: HTMLElement, name: HTMLElement}[]} */
  let tags = [];
  let on = false;
  let turn = 0;
  /** @type {string | null} */
  let pointed = null;
  /** @type {{id: number, x: number, y: number} | null} */
  let press = null;

  /**
   * Where a line from the eye enters a thing, in lengths of the line; Infinity where it does not.
   * @param {Thing} thing @param {number[]} eye @param {number[]} along
   */
  function enters(thing, eye, along) {
    const [c, s] = [Math.cos(thing.yaw), Math.sin(thing.yaw)];
    const [x, y] = [eye[0] - thing.x, eye[1] - thing.y];
    const from = [c * x + s * y, -s * x + c * y, eye[2] - thing.height / 2];
    const way = [c * along[0] + s * along[1], -s * along[0] + c * along[1], along[2]];
    const half = [thing.length / 2, thing.width / 2, thing.height / 2];
    let [first, last] = [0, Infinity];
    for (let k = 0; k < 3; k += 1) {
      const [a, b] = [(-half[k] - from[k]) / way[k], (half[k] - from[k]) / way[k]];
      first = Math.max(first, Math.min(a, b));
      last = Math.min(last, Math.max(a, b));
    }
    return first <= last ? first : Infinity;
  }

  /** The object that a line from the eye meets first. @param {number[]} eye @param {number[]} along @returns {string | null} */
  function met(eye, along) {
    let [found, nearest] = [/** @type {string | null} */ (null), Infinity];
    for (const { thing } of tags) {
      const at = enters(thing, eye, along);
      if (at < nearest) [found, nearest] = [thing.thing, at];
    }
    return found;
  }

  /** The object under a pixel, nearest to the eye. @param {number} px @param {number} py */
  function under(px, py) {
    const { eye, along } = viser.ray(px, py);
    return met(eye, along);
  }

  /** Places all over a thing that may be seen: its lid, and its sides from top to bottom. @param {Thing} thing */
  function surface({ x, y, yaw, length, width, height }) {
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const spots = [];
    for (const z of SHARES) {
      for (const a of SHARES) {
        for (const b of SHARES) {
          if (z < 1 && Math.abs(a) < 1 && Math.abs(b) < 1) continue; // inside
          const [along, aside] = [(0.98 * a * length) / 2, (0.98 * b * width) / 2];
          spots.push([x + c * along - s * aside, y + s * along + c * aside, ((0.98 * z + 1) / 2) * height]);
        }
      }
    }
    return spots;
  }

  /**
   * Over what of a thing is seen: the middle and the upper edge of it in the picture, null where other things hide all.
   * @param {Thing} thing @param {number[]} eye @param {Projector} project
   */
  function overhead(thing, eye, project) {
    const others = tags.filter((one) => one.thing !== thing).map((one) => one.thing);
    const [width, height, top] = [window.innerWidth, window.innerHeight, window.desirePath.sheet.covered()];
    let [left, right, foot, seen] = [Infinity, -Infinity, Infinity, 0];
    const spots = surface(thing);
    for (const spot of spots) {
      const at = project(spot[0], spot[1], spot[2]);
      if (!at || at[0] < 0 || at[0] > width || at[1] < top || at[1] > height) continue;
      const along = spot.map((value, k) => value - eye[k]);
      if (others.some((other) => enters(other, eye, along) < 1)) continue;
      [left, right, foot, seen] = [Math.min(left, at[0]), Math.max(right, at[0]), Math.min(foot, at[1]), seen + 1];
    }
    return seen >= LEAST_SEEN * spots.length ? { x: Math.round((left + right) / 2), foot: Math.round(foot) - ABOVE_PX } : null;
  }

  /** A name may be clicked as well as the object. @param {PointerEvent} event */
  function at(event) {
    const over = tags.find(({ tag }) => {
      const box = tag.getBoundingClientRect();
      return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
    });
    return over ? over.thing.thing : under(event.clientX, event.clientY);
  }

  /** @param {string | null} thing */
  function point(thing) {
    pointed = thing;
    for (const { thing: one, tag } of tags) tag.toggleAttribute("data-pointed", one.thing === thing);
    document.documentElement.toggleAttribute("data-pickable", thing !== null);
  }

  const { element } = window.desirePath.sheet;
  element.addEventListener("pointerdown", (event) => {
    if (on && event.button === 0) press = { id: event.pointerId, x: event.clientX, y: event.clientY };
  });
  element.addEventListener("pointermove", (event) => {
    if (!on || event.pointerType === "touch") return;
    const thing = at(event);
    if (thing === pointed) return;
    point(thing);
    bridge.post("pointed", { thing });
  });
  element.addEventListener("pointerup", (event) => {
    const began = press;
    press = null;
    if (!on || !began || began.id !== event.pointerId) return;
    if (Math.hypot(event.clientX - began.x, event.clientY - began.y) > STILL_PX) return;
    const thing = at(event);
    if (thing) bridge.post("picked", { thing });
  });

  /**
   * Nobody's name covers another's: each stands where it belongs, or as near above or below that as it is free.
   * @template {{x: number, foot: number, width: number, height: number}} Spot
   * @param {Spot[]} spots in an order that does not change while the camera turns
   * @param {{x: number, foot: number, width: number, height: number}[]} taken by something else
   */
  function apart(spots, taken) {
    /** @type {Spot[]} */
    const found = [];
    const placed = [...taken];
    const top = window.desirePath.sheet.covered();
    for (const spot of spots) {
      const beside = placed.filter((one) => Math.abs(spot.x - one.x) < (spot.width + one.width) / 2);
      /** @param {number} foot */
      const free = (foot) => beside.every((one) => foot <= one.foot - one.height || foot - spot.height >= one.foot);
      const others = beside.flatMap((one) => [one.foot - one.height, one.foot + spot.height]);
      const feet = [spot.foot, ...others.filter((foot) => foot >= top + spot.height)].filter(free);
      feet.sort((a, b) => Math.abs(a - spot.foot) - Math.abs(b - spot.foot));
      found.push({ ...spot, foot: feet[0] ?? spot.foot });
      placed.push(found[found.length - 1]);
    }
    return found;
  }

  /** Names stay over their objects when the camera turns; no name stands on what hides its object. @param {number} mine */
  function pin(mine) {
    if (mine !== turn) return;
    const [project, { eye }] = [viser.projector(), viser.ray(0, 0)];
    const { explained, sheet } = window.desirePath;
    explained.follow();
    const spots = [];
    for (const { thing, tag } of tags) {
      const over = overhead(thing, eye, project);
      tag.hidden = !over;
      if (!over) continue;
      const { width, height } = tag.getBoundingClientRect();
      const half = width / 2 + 2;
      const x = Math.max(half, Math.min(window.innerWidth - half, over.x));
      const foot = Math.max(sheet.covered() + height + 2, over.foot);
      spots.push({ tag, x, foot, belongs: foot, width: width + 2, height: Math.ceil(height) + 1 });
    }
    for (const { tag, x, foot, belongs } of apart(spots, explained.sign())) {
      tag.style.transform = `translate(${x}px, ${foot}px) translate(-50%, -100%)`;
      tag.style.setProperty("--stem", `${Math.max(0, belongs - foot)}px`);
    }
    requestAnimationFrame(() => pin(mine));
  }

  /** @param {Record<string, string>} words thing -> what people call it */
  function begin(words) {
    const { explained, camera } = window.desirePath;
    tags = explained.objects().map((thing) => {
      const [tag, place, name] = [document.createElement("div"), document.createElement("b"), document.createElement("span")];
      tag.className = "desire-path-tag";
      tag.dataset.thing = thing.thing;
      tag.setAttribute("aria-hidden", "true");
      name.textContent = words[thing.thing] ?? "";
      tag.append(place, name);
      return { thing, tag, place, name };
    });
    element.append(...tags.map(({ tag }) => tag));
    on = true;
    document.documentElement.dataset.picking = "on";
    explained.hide(true);
    if (document.documentElement.dataset.view === "first_person") camera.look();
    pin(++turn);
  }

  window.desirePath.picking = {
    /** A hand with a headset presses there. @param {number[]} from @param {number[]} along @returns {boolean} whether an object */
    press(from, along) {
      const thing = on ? met(from, along) : null;
      if (thing) bridge.post("picked", { thing });
      return thing !== null;
    },
    /** What stands over the objects in a headset. @param {{from: number[], along: number[]}[]} rays of the hands */
    labels(rays) {
      const aimed = rays.map(({ from, along }) => met(from, along));
      return tags.map(({ thing: { thing, x, y, height }, place, name }) => ({
        at: [x, y, height],
        text: place.textContent ? `${place.textContent}  ${name.textContent}` : (name.textContent ?? ""),
        on: thing === pointed || aimed.includes(thing),
      }));
    },
    stop() {
      on = false;
      turn += 1;
      for (const { tag } of tags) tag.remove();
      tags = [];
      point(null);
      delete document.documentElement.dataset.picking;
    },
    /** `rank`: the objects may be picked, these have places already, this one is meant on the page. @param {any} message */
    obey(message) {
      if (message.do !== "rank" || !window.desirePath.explained.objects().length) return;
      if (!on) begin(message.words ?? {});
      const places = /** @type {string[]} */ (message.places ?? []);
      for (const { thing, tag, place } of tags) {
        const k = places.indexOf(thing.thing);
        place.textContent = k < 0 ? "" : String(k + 1);
        tag.toggleAttribute("data-placed", k >= 0);
      }
      point(message.pointed ?? null);
    },
  };
})();
