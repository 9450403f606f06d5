// @ts-check
/**
 * Light or dark, as the page around the stage: in the dark the room is dimmed and who moves in it is not, so that both
 * stand out as they do in the light. Colours of what lies over the picture are stage.css's.
 */
(() => {
  "use strict";
  const { viser } = window.desirePath;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const [ROOM, PEOPLE, GOAL] = [0.42, 3.0, 1.6]; // as in tests/stage/test_looks.py
  const TRAIL = { light: [22, 96, 54], dark: [150, 214, 160] };
  /** @type {string[]} */
  let names = [];
  /** @type {Record<string, string>} */
  let known = {};

  function tint() {
    known = {};
    for (const name of names) {
      const factor = name.endsWith("/place") ? ROOM : name.endsWith("/goal") ? GOAL : 1;
      viser.tint(name, dark.matches ? factor : 1, dark.matches ? PEOPLE : 1);
    }
    if (names.length) viser.redraw();
  }
  dark.addEventListener("change", tint);

  window.desirePath.scheme = {
    /** The scene's meshes stand. @param {string[]} meshes */
    use(meshes) {
      names = meshes;
      tint();
    },
    isDark: () => dark.matches,
    /** Red, green, blue. */
    trail: () => (dark.matches ? TRAIL.dark : TRAIL.light),
    /** A colour of stage.css. @param {string} name of its custom property */
    colour: (name) => (known[name] ??= getComputedStyle(document.documentElement).getPropertyValue(name).trim()),
  };
})();
