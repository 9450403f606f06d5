// @ts-check
/**
 * Plays trajectories by the browser's own clock: label, motion, a moment of rest, then one `played` to the page.
 *
 * Between the 5 Hz samples the path is a Catmull-Rom curve, which passes through every sample.
 */
(() => {
  "use strict";
  const { bridge, frames } = window.desirePath;
  const UNSEEN_MS = 10000; // without a picture in a headset: nobody wore it, and slow graphics are no reason
  /** @type {string[]} */
  let robots = [];
  let person = "";
  /** @type {number[]} */
  let stands = [0, 0, 0];
  /** Who walks beside the person. @type {Orders["show"]["crowd"]} */
  let crowd = [];
  /** x, y, radius, where it is shown. @type {number[] | null} */
  let goal = null;
  /** Where they are now, x, y, yaw each. @type {number[][]} */
  let walkers = [];
  /** Counts playbacks; a frame of an older one sees that it is over. */
  let turn = 0;
  /** @type {string | null} */
  let running = null;
  /** What was played last in this scene. @type {{tracks: Track[], walked: Track | null} | null} */
  let played = null;

  /** @param {Track} track @param {number} t seconds @returns {number[]} [x, y, yaw] */
  function at(track, t) {
    const last = track.length - 1;
    if (t <= track[0][0] || last === 0) return track[0].slice(1);
    if (t >= track[last][0]) return track[last].slice(1);
    let low = 0;
    let high = last;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (track[middle][0] <= t) low = middle;
      else high = middle;
    }
    const u = (t - track[low][0]) / (track[high][0] - track[low][0]);
    const before = track[Math.max(0, low - 1)];
    const after = track[Math.min(last, high + 1)];
    return [1, 2, 3].map((i) => {
      const [p0, p1, p2, p3] = [before[i], track[low][i], track[high][i], after[i]];
      return p1 + 0.5 * u * (p2 - p0 + u * (2 * p0 - 5 * p1 + 4 * p2 - p3 + u * (3 * (p1 - p2) + p3 - p0)));
    });
  }

  /** @param {number[]} where x, y, yaw: the person is here now, and in their view so are the eyes */
  function put([x, y, yaw]) {
    if (person) window.desirePath.bodies.put(person, x, y, yaw);
    window.desirePath.camera.stand(x, y);
  }

  /** Pedestrians are where they are at `t`, whatever else moves. @param {number} t */
  function poseCrowd(t) {
    walkers = crowd.map(({ track }) => at(track, t));
    walkers.forEach(([x, y, yaw], k) => window.desirePath.bodies.put(crowd[k].name, x, y, yaw));
  }

  /** @param {Track[]} tracks @param {number} t @param {Track | null} walked */
  function pose(tracks, t, walked) {
    poseCrowd(t);
    window.desirePath.pictures.at(t);
    if (walked) put(at(walked, t));
    tracks.forEach((track, i) => {
      const [x, y, yaw] = at(track, t);
      window.desirePath.bodies.put(robots[i], x, y, yaw);
      if (i !== 0) return;
      window.desirePath.camera.watch(x, y);
      window.desirePath.sound.at(x, y, yaw);
      window.desirePath.explained.at(t, x, y, yaw);
      window.desirePath.trail.at(track, t);
    });
  }

  /** @param {Track[]} tracks */
  const length = (tracks) => Math.max(...tracks.map((track) => track[track.length - 1][0]));

  window.desirePath.player = {
    along: at,
    walkers: () => walkers,

    /** @param {string[]} names frames that move, one per track @param {string} [who] the person's @param {number[]} [where] @param {Orders["show"]["crowd"]} [people] who walk @param {number[] | null} [aim] */
    use(names, who = "", where = [0, 0, 0], people = [], aim = null) {
      this.interrupt("another-scene");
      [robots, person, stands, crowd, goal] = [names, who, where, people, aim];
      played = null;
    },

    /** The person stands where that walk has them at `t`. @param {Track} walked @param {number} t */
    walkTo(walked, t) {
      const [x, y, yaw] = at(walked, t);
      window.desirePath.bodies.put(person, x, y, yaw);
    },

    walkCrowdTo: poseCrowd,

    /** A robot stands there. @param {number} i which one @param {number[]} where x, y, yaw @param {boolean} watched the camera follows it where it follows any */
    place(i, [x, y, yaw], watched) {
      window.desirePath.bodies.put(robots[i], x, y, yaw);
      if (!watched) return;
      window.desirePath.camera.watch(x, y);
      window.desirePath.sound.at(x, y, yaw);
    },

    /** @param {Orders["play"]} order */
    play(order) {
      this.interrupt("another-trajectory");
      const mine = ++turn;
      const { tracks, label_s: labelS, hold_s: holdS, playback_id: id, person: walked, walk: ground } = order;
      const { walk } = window.desirePath;
      const motionS = length(tracks);
      const begun = performance.now();
      let lastFrame = begun;
      let longestGap = 0;
      let drawn = 0;
      let moving = false;
      running = id;
      played = { tracks, walked };
      bridge.state.playback_id = id;
      window.desirePath.camera.hold();
      put(stands);
      window.desirePath.camera.recentre();
      window.desirePath.explained.begin();
      window.desirePath.headset.begin();
      window.desirePath.headPose.moves(begun + labelS * 1000);
      if (ground) walk.begin(ground);
      pose(tracks, 0, walked);
      let met = false;
      if (order.label) {
        // Where nothing stands before the robot moves, so that A and B have the same place.
        const [, x, y] = tracks[0][0];
        const above = document.documentElement.dataset.view === "top_down";
        window.desirePath.sheet.label(order.label, [[x, y], ...(above ? [stands] : []), ...(goal ? [goal] : []), ...walkers]);
        bridge.post("label", { playback_id: id, label: order.label });
      }
      const step = () => {
        if (mine !== turn) return;
        const now = performance.now();
        const worn = document.documentElement.dataset.headset === "on";
        if (worn && now - lastFrame > UNSEEN_MS) { // it was off the head meanwhile
          window.desirePath.player.interrupt("tab-hidden");
          return;
        }
        const t = (now - begun) / 1000 - labelS;
        if (t >= 0) {
          if (!moving) {
            moving = true;
            window.desirePath.sheet.label("");
            bridge.post("playing", { playback_id: id });
          } else {
            longestGap = Math.max(longestGap, now - lastFrame);
          }
          pose(tracks, t, walked);
          if (ground) {
            const here = walk.advance(Math.min(t, motionS), (/** @type {number} */ time) => at(tracks[0], time));
            window.desirePath.bodies.put(person, here.x, here.y, here.yaw);
            met ||= here.met;
          }
          drawn += 1;
        }
        lastFrame = now;
        if (!met && t < motionS + holdS) {
          frames.next(step);
          return;
        }
        running = null;
        bridge.state.playback_id = null;
        bridge.post("played", {
          playback_id: id,
          frames: drawn,
          duration_ms: Math.round(now - begun),
          longest_gap_ms: Math.round(longestGap),
          headset: window.desirePath.headset.report(),
          ...(ground ? { walk: walk.recording() } : {}),
        });
        walk.stop();
      };
      frames.next(step);
    },

    /** What was played stands as it was after so many seconds; nothing where something plays. @param {number} seconds */
    still(seconds) {
      if (played && running === null) pose(played.tracks, seconds, played.walked);
    },

    /** The robot stands where its rollout ended. @param {number[]} pose x, y, yaw */
    end([x, y, yaw]) {
      poseCrowd(Infinity);
      window.desirePath.bodies.put(robots[0], x, y, yaw);
      window.desirePath.camera.watch(x, y);
      window.desirePath.explained.at(Infinity, x, y, yaw);
    },

    /** Nothing moves, the first robot stands there, the person in their place. @param {number[]} start x, y, yaw */
    rest([x, y, yaw]) {
      this.interrupt("stopped");
      window.desirePath.camera.hold();
      poseCrowd(0);
      put(stands);
      window.desirePath.bodies.put(robots[0], x, y, yaw);
      window.desirePath.camera.watch(x, y);
    },

    /** @param {Orders["replay"]} order */
    replay({ tracks, person: walked, speed, loop }) {
      this.interrupt("another-trajectory");
      const mine = ++turn;
      const motionS = length(tracks);
      const restS = 1.0;
      const begun = performance.now();
      window.desirePath.explained.begin();
      const step = () => {
        if (mine !== turn) return;
        const t = ((performance.now() - begun) / 1000) * speed;
        pose(tracks, loop ? t % (motionS + restS * speed) : t, walked);
        if (loop || t < motionS) frames.next(step);
      };
      frames.next(step);
    },

    /** @param {string} reason stops whatever moves; a trajectory that was being watched is reported */
    interrupt(reason) {
      turn += 1;
      window.desirePath.sheet?.label("");
      window.desirePath.walk?.stop();
      if (running === null) return;
      bridge.post("interrupted", { playback_id: running, reason });
      running = null;
      bridge.state.playback_id = null;
    },
  };
})();
