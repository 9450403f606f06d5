// @ts-check
/** The three views as a camera in this window: fitted from above, following from the eyes, or turned by the gaze. */
(() => {
  "use strict";
  const MAX_PITCH = 1.4;
  const ASLANT_RAD = 1.0;
  const ASLANT_FOV_RAD = 0.6;

  /** @type {Orders["camera"] | null} */
  let camera = null;
  let free = false;
  /** The gaze follows the hand in both views from the eyes, not the robot: while somebody draws. */
  let gazing = false;
  let yaw = 0;
  let pitch = 0;
  /** The participant walks and turns their head as they like. */
  let walking = false;
  /** @type {number[]} */
  let watched = [0, 0];

  function lookFromAbove() {
    if (!camera) return;
    const [xMin, yMin, xMax, yMax] = camera.frame;
    const width = xMax - xMin;
    const height = yMax - yMin;
    const covered = window.desirePath.sheet.covered();
    const free = Math.max(1, window.innerHeight - covered);
    const aspect = window.innerWidth / free;
    const upright = Math.max(height, width / aspect);
    const lying = Math.max(width, height / aspect);
    // A long room lies along the long side of the window, the same way for A and B.
    const up = lying < 0.95 * upright ? [1, 0, 0] : [0, 1, 0];
    const metres = (Math.min(upright, up[0] ? lying : upright) * window.innerHeight) / free;
    const distance = metres / 2 / Math.tan(camera.fov_rad / 2);
    const higher = ((covered / 2) * metres) / window.innerHeight; // the picture begins under the legend
    const middle = [(xMin + xMax) / 2 + up[0] * higher, (yMin + yMax) / 2 + up[1] * higher];
    // Far off, a near plane at the nose would leave too little depth to tell a lid from the crate under it.
    window.desirePath.viser.look({
      eye: [...middle, distance], target: [...middle, 0], up, fovRad: camera.fov_rad, near: distance / 2,
    });
  }

  function lookFromAslant() {
    if (!camera) return;
    const [xMin, yMin, xMax, yMax] = camera.frame;
    const [width, height] = [xMax - xMin, yMax - yMin];
    const covered = window.desirePath.sheet.covered();
    const free = Math.max(1, window.innerHeight - covered);
    const aspect = window.innerWidth / free;
    const [long, short] = [Math.max(width, height), Math.min(width, height)];
    const near = (0.58 * Math.max(long / aspect, short)) / Math.tan(ASLANT_FOV_RAD / 2) + short / 4;
    const distance = (near * window.innerHeight) / free;
    const back = distance * Math.cos(ASLANT_RAD);
    const farther = ((covered / window.innerHeight) * distance * Math.tan(ASLANT_FOV_RAD / 2)) / Math.sin(ASLANT_RAD);
    const lies = width >= height;
    const middle = [(xMin + xMax) / 2 + (lies ? 0 : farther), (yMin + yMax) / 2 + (lies ? farther : 0)];
    const eye = lies ? [middle[0], middle[1] - back] : [middle[0] - back, middle[1]];
    window.desirePath.viser.look({
      eye: [...eye, distance * Math.sin(ASLANT_RAD)], target: [...middle, 0], up: [0, 0, 1], fovRad: ASLANT_FOV_RAD, near: 0.3,
    });
  }

  function lookByGaze() {
    if (!camera) return;
    const [x, y, z] = camera.eye;
    const flat = Math.cos(pitch);
    const target = [x + flat * Math.cos(yaw), y + flat * Math.sin(yaw), z + Math.sin(pitch)];
    window.desirePath.viser.look({ eye: camera.eye, target, up: [0, 0, 1], fovRad: camera.fov_rad });
  }

  function apply() {
    if (!camera || free || !window.desirePath.viser.isUp()) return;
    if (camera.view === "top_down") lookFromAbove();
    else if (gazing || walking || camera.view === "immersive") lookByGaze();
    else {
      const target = [watched[0], watched[1], camera.target[2]];
      window.desirePath.viser.look({ eye: camera.eye, target, up: [0, 0, 1], fovRad: camera.fov_rad });
    }
    find();
  }

  let finding = false;
  /** In the next picture, when the eye looks where it was told to, an arrow tells where the robot is. */
  function find() {
    if (finding) return;
    finding = true;
    requestAnimationFrame(() => {
      finding = false;
      const { finder } = window.desirePath;
      if (!camera || free || camera.view === "top_down" || !Number.isFinite(watched[0])) finder.rest();
      else finder.look(watched[0], watched[1]);
    });
  }

  window.addEventListener("resize", () => requestAnimationFrame(apply));

  window.desirePath.camera = {
    /** @param {Orders["camera"]} next */
    use(next) {
      free = gazing = walking = false;
      window.desirePath.viser.orbit(false);
      camera = next;
      document.documentElement.dataset.view = next.view;
      delete document.documentElement.dataset.camera;
      watched = next.target.slice(0, 2);
      this.recentre();
    },
    /** The gaze of the immersive view back to where the robot starts, the same for every trajectory in a scene. */
    recentre() {
      if (!camera) return;
      const { eye, target } = camera;
      const [dx, dy, dz] = target.map((value, i) => value - eye[i]);
      yaw = Math.atan2(dy, dx);
      pitch = Math.max(-0.35, Math.atan2(dz, Math.hypot(dx, dy)));
      apply();
    },
    /** @param {number} x @param {number} y the robot is here now */
    watch(x, y) {
      watched = [x, y];
      if (camera?.view === "first_person") apply();
      else find();
    },
    /** Where the robot is that is watched. */
    watched: () => watched,
    /** What covers the picture has another height. */
    fit: apply,
    /** Whether the gaze can be turned now. */
    mayTurn: () =>
      camera !== null && !free && (camera.view === "immersive" || ((gazing || walking) && camera.view !== "top_down")),
    /** Let the gaze be turned in the first person, too, and begin with a look at this place. @param {number[] | null} at */
    gaze(at) {
      gazing = at !== null;
      if (camera && at) {
        const [dx, dy, dz] = [at[0] - camera.eye[0], at[1] - camera.eye[1], -camera.eye[2]];
        yaw = Math.atan2(dy, dx);
        pitch = Math.max(-0.6, Math.atan2(dz, Math.hypot(dx, dy)));
      }
      apply();
    },
    /** In the first person, let the gaze be turned from where it is. */
    look() {
      gazing = true;
      if (!camera) return;
      const [dx, dy, dz] = [watched[0] - camera.eye[0], watched[1] - camera.eye[1], camera.target[2] - camera.eye[2]];
      yaw = Math.atan2(dy, dx);
      pitch = Math.atan2(dz, Math.hypot(dx, dy));
      apply();
    },
    /** Whether a place on the floor lies to the left of where the eyes look. @param {number} x @param {number} y */
    isLeft: (x, y) => camera !== null && Math.sin(Math.atan2(y - camera.eye[1], x - camera.eye[0]) - yaw) > 0,
    /** @param {number} left @param {number} up radians */
    turn(left, up) {
      if (!this.mayTurn()) return;
      yaw += left;
      pitch = Math.max(-MAX_PITCH, Math.min(MAX_PITCH, pitch + up));
      apply();
    },
    /** Which way the eyes look, radians. */
    heading: () => yaw,
    /** @param {boolean} on whether the participant's own feet and head move it */
    walk(on) {
      walking = on;
      apply();
    },
    /** The eyes go where the person is. @param {number} x @param {number} y */
    stand(x, y) {
      if (!camera || camera.view === "top_down") return;
      camera.eye = [x, y, camera.eye[2]];
      apply();
    },
    /** Back from `release` to the scene's own view. */
    hold() {
      if (!free) return;
      free = false;
      window.desirePath.viser.orbit(false);
      delete document.documentElement.dataset.camera;
      apply();
    },
    /** Hand the camera to viser's own controls (replays); from above it first leans back to show height. */
    release() {
      if (camera?.view === "top_down") lookFromAslant();
      free = true;
      find();
      window.desirePath.viser.orbit(true);
      document.documentElement.dataset.camera = "free";
    },
  };
})();
