// @ts-check
/** How far a lidar in the room sees: plain geometry on the floor, metres and radians, no picture. */
(() => {
  "use strict";

  window.desirePath.rays = {
    /**
     * @param {{solids: Solid[], person: Round, range_m: number}} place
     * @param {number} x @param {number} y @param {number} yaw of the lidar
     * @param {number[]} bearings of its beams, from straight ahead counter-clockwise
     * @returns {Float64Array} how far each goes, at most the range
     */
    cast({ solids, person, range_m: range }, x, y, yaw, bearings) {
      const beams = bearings.length;
      const reach = new Float64Array(beams).fill(range);
      const [ahead, aside] = [new Float64Array(beams), new Float64Array(beams)];
      for (let k = 0; k < beams; k += 1) {
        const angle = yaw + bearings[k];
        ahead[k] = Math.cos(angle);
        aside[k] = Math.sin(angle);
      }
      for (const solid of solids) {
        const [c, s] = [Math.cos(solid.yaw), Math.sin(solid.yaw)];
        const along = c * (x - solid.x) + s * (y - solid.y);
        const across = -s * (x - solid.x) + c * (y - solid.y);
        const [halfLength, halfWidth] = [solid.length / 2, solid.width / 2];
        if (Math.hypot(Math.max(0, Math.abs(along) - halfLength), Math.max(0, Math.abs(across) - halfWidth)) > range) continue;
        for (let k = 0; k < beams; k += 1) {
          const [dx, dy] = [c * ahead[k] + s * aside[k], -s * ahead[k] + c * aside[k]];
          // where the ray enters and leaves the strip between two sides, then the other strip
          const [ax, bx] = [(-halfLength - along) / dx, (halfLength - along) / dx];
          const [ay, by] = [(-halfWidth - across) / dy, (halfWidth - across) / dy];
          const enters = Math.max(Math.min(ax, bx), Math.min(ay, by));
          const leaves = Math.min(Math.max(ax, bx), Math.max(ay, by));
          if (enters <= leaves && enters >= 0 && enters < reach[k]) reach[k] = enters;
        }
      }
      const [px, py] = [person.x - x, person.y - y];
      for (let k = 0; k < beams; k += 1) {
        const near = px * ahead[k] + py * aside[k];
        const off = px * px + py * py - near * near;
        if (near <= 0 || off > person.radius * person.radius) continue;
        const enters = near - Math.sqrt(person.radius * person.radius - off);
        if (enters >= 0 && enters < reach[k]) reach[k] = enters;
      }
      return reach;
    },
  };
})();
