// @ts-check
/** How much room a robot on the floor has: plain geometry in metres, no picture. The server decides what counts. */
(() => {
  "use strict";

  /** @param {Solid} solid @param {number} x @param {number} y @returns {{metres: number, at: number[]}} */
  function toSolid(solid, x, y) {
    const [c, s] = [Math.cos(solid.yaw), Math.sin(solid.yaw)];
    const along = c * (x - solid.x) + s * (y - solid.y);
    const across = -s * (x - solid.x) + c * (y - solid.y);
    const [halfLength, halfWidth] = [solid.length / 2, solid.width / 2];
    const [outAlong, outAcross] = [Math.abs(along) - halfLength, Math.abs(across) - halfWidth];
    const inside = Math.min(Math.max(outAlong, outAcross), 0);
    const nearAlong = Math.max(-halfLength, Math.min(halfLength, along));
    const nearAcross = Math.max(-halfWidth, Math.min(halfWidth, across));
    return {
      metres: Math.hypot(Math.max(outAlong, 0), Math.max(outAcross, 0)) + inside,
      at: [solid.x + c * nearAlong - s * nearAcross, solid.y + s * nearAlong + c * nearAcross],
    };
  }

  /** @param {Round} round @param {number} x @param {number} y */
  function toRound(round, x, y) {
    const [dx, dy] = [x - round.x, y - round.y];
    const away = Math.hypot(dx, dy) || 1e-9;
    return { metres: away - round.radius, at: [round.x + (dx / away) * round.radius, round.y + (dy / away) * round.radius] };
  }

  window.desirePath.clearance = {
    toSolid,

    /**
     * @param {Surroundings} place
     * @param {(t: number) => number[]} [personAt] x, y of a person who walks, t seconds after the robot began
     * @returns {Finds} the nearest thing for a robot whose middle is there then
     */
    of(place, personAt) {
      return (x, y, t) => {
        const [px, py] = personAt ? personAt(t) : [place.person.x, place.person.y];
        /** @type {NearThing} */
        let nearest = { name: place.person.name, ...toRound({ ...place.person, x: px, y: py }, x, y) };
        for (const solid of place.solids) {
          const found = toSolid(solid, x, y);
          if (found.metres < nearest.metres) nearest = { name: solid.name, ...found };
        }
        return { ...nearest, metres: nearest.metres - place.robot_radius };
      };
    },

    /** The stretches of a path that are tighter than `least`. @param {NearThing[]} nears one per point @param {number} least metres @returns {TightStretch[]} */
    tight(nears, least) {
      /** @type {TightStretch[]} */
      const found = [];
      nears.forEach((near, i) => {
        if (near.metres >= least) return;
        const last = found[found.length - 1];
        if (last && last.to === i - 1 && last.near.name === near.name) {
          last.to = i;
          if (near.metres < last.near.metres) Object.assign(last, { near, worst: i });
        } else found.push({ from: i, to: i, worst: i, near });
      });
      return found;
    },
  };
})();
