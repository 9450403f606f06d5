// @ts-check
/**
 * What moved the policy, shown in the room while it drives: an object's outline is as thick as its score (in metres, at
 * the policy's own 5 Hz), lidar rays are green where they are free and end in a red mark where they hit something, a
 * dashed line leads to the goal's ring, and a sign says that the robot halted.
 *
 * The meshes are the server's (app/desirepath_stage/explained_nodes.py); here their corners are moved. Picking objects is picking.js's.
 */
(() => {
  "use strict";
  const { viser, rays, attention } = window.desirePath;
  const STEP_S = 0.2; // of the scores
  const RAY_HEIGHT_M = 0.2;
  const LINE_HEIGHT_M = 0.03;
  const LINE_M = 0.05;
  const [DASH_M, EVERY_M] = [0.18, 0.3];
  const [NARROW_M, WIDER] = [0.0015, 0.0024]; // a ray's width at the robot, and how much wider per metre
  const MARK_M = 0.045;
  const RIM_M = 0.018;
  const [FREE, HIT, MARK] = [[24, 122, 62, 105], [196, 34, 26, 120], [176, 20, 14, 255]];
  const CORNERS = 8; // of a ray's mesh: four of the ray, four of its mark
  const LIGHTER = 3; // on phones one ray of so many

  /** @type {NonNullable<Orders["show"]["explained"]> | null} */
  let order = null;
  /** @typedef {{mesh: any, corners: Float32Array, outwards: Float32Array, rim: number}} Hull */
  /** @type {Hull[][]} */
  let hulls = [];
  /** @type {any} */
  let rayMesh = null;
  /** @type {any} */
  let lineMesh = null;
  let row = -1;
  let hidden = false;
  /** Where the robot is now. */
  let [atX, atY] = [0, 0];
  let halted = false;

  const stop = document.createElement("div");
  stop.id = "desire-path-stop";
  stop.setAttribute("aria-hidden", "true"); // the page says so
  stop.append(Object.assign(document.createElement("span"), { textContent: "STOP" }));
  const legend = document.createElement("ul");
  legend.id = "desire-path-reasons";

  const lighter = () => matchMedia("(pointer: coarse)").matches || window.innerWidth < 700;

  /** @param {any} mesh @param {number} corner @param {number} x @param {number} y @param {number} z */
  function put(mesh, corner, x, y, z) {
    const { array } = mesh.geometry.attributes.position;
    [array[3 * corner], array[3 * corner + 1], array[3 * corner + 2]] = [x, y, z];
  }

  /** @param {any} mesh @param {number} from @param {number} corners @param {number[]} colour */
  function paint(mesh, from, corners, colour) {
    const { array } = mesh.geometry.attributes.color;
    for (let k = from; k < from + corners; k += 1) array.set(colour, 4 * k);
  }

  /** @param {any} mesh */
  function changed(mesh) {
    mesh.geometry.attributes.position.needsUpdate = true;
    mesh.geometry.attributes.color.needsUpdate = true;
  }

  /** @param {number} yaw */
  function drawRays(yaw) {
    if (!order || !rayMesh) return;
    const every = lighter() ? LIGHTER : 1;
    const [length, width] = order.walker;
    const walkers = window.desirePath.player.walkers().map(([x, y, facing]) => ({ name: "", x, y, yaw: facing, length, width }));
    const place = { ...order, solids: [...order.solids, ...walkers] };
    const [mountX, mountY, mountYaw] = order.mount;
    const [fromX, fromY] = [atX + mountX * Math.cos(yaw) - mountY * Math.sin(yaw), atY + mountX * Math.sin(yaw) + mountY * Math.cos(yaw)];
    const bearings = order.bearings.filter((_, k) => k % every === 0);
    const reach = rays.cast(place, fromX, fromY, yaw + mountYaw, bearings);
    const [rim, off] = [order.robot_radius ** 2, mountX ** 2 + mountY ** 2];
    reach.forEach((far, k) => {
      const angle = yaw + mountYaw + bearings[k];
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      const along = (fromX - atX) * c + (fromY - atY) * s;
      const edge = off < rim ? Math.sqrt(rim - off + along * along) - along : 0; // it is seen from where it leaves the robot
      const hit = far < (order?.range_m ?? 0);
      const [near, wide] = [NARROW_M / 2, (every * (NARROW_M + WIDER * far)) / 2];
      const at = k * CORNERS;
      const end = Math.max(far, edge);
      put(rayMesh, at, fromX + edge * c + near * s, fromY + edge * s - near * c, RAY_HEIGHT_M);
      put(rayMesh, at + 1, fromX + end * c + wide * s, fromY + end * s - wide * c, RAY_HEIGHT_M);
      put(rayMesh, at + 2, fromX + end * c - wide * s, fromY + end * s + wide * c, RAY_HEIGHT_M);
      put(rayMesh, at + 3, fromX + edge * c - near * s, fromY + edge * s + near * c, RAY_HEIGHT_M);
      // the mark stands just before what was hit, lying as well as standing, so that every view sees it
      const [mx, my, m] = [fromX + (end - 0.03) * c, fromY + (end - 0.03) * s, hit ? MARK_M : 0];
      put(rayMesh, at + 4, mx - m * s, my + m * c, RAY_HEIGHT_M);
      put(rayMesh, at + 5, mx - m * c, my - m * s, RAY_HEIGHT_M + m);
      put(rayMesh, at + 6, mx + m * s, my - m * c, RAY_HEIGHT_M);
      put(rayMesh, at + 7, mx - m * c, my - m * s, RAY_HEIGHT_M - m);
      paint(rayMesh, at, 4, hit ? HIT : FREE);
      paint(rayMesh, at + 4, 4, MARK);
    });
    changed(rayMesh);
  }

  function drawLine() {
    if (!order || !lineMesh) return;
    const [gx, gy, radius] = order.goal;
    const away = Math.hypot(gx - atX, gy - atY) || 1;
    const [c, s] = [(gx - atX) / away, (gy - atY) / away];
    const dashes = lineMesh.geometry.attributes.position.count / 4;
    for (let k = 0; k < dashes; k += 1) {
      const from = Math.min(order.robot_radius + k * EVERY_M, Math.max(order.robot_radius, away - radius));
      const to = Math.min(from + DASH_M, Math.max(from, away - radius));
      const w = to > from ? LINE_M / 2 : 0;
      put(lineMesh, 4 * k, atX + from * c + w * s, atY + from * s - w * c, LINE_HEIGHT_M);
      put(lineMesh, 4 * k + 1, atX + to * c + w * s, atY + to * s - w * c, LINE_HEIGHT_M);
      put(lineMesh, 4 * k + 2, atX + to * c - w * s, atY + to * s + w * c, LINE_HEIGHT_M);
      put(lineMesh, 4 * k + 3, atX + from * c - w * s, atY + from * s + w * c, LINE_HEIGHT_M);
    }
    changed(lineMesh);
  }

  /** @param {number} now index of the scores' row */
  function drawOutlines(now) {
    if (!order) return;
    hulls.forEach((both, i) => {
      const thick = (order?.thickest_m ?? 0) * (order?.scores[now][i] ?? 0);
      for (const { mesh, corners, outwards, rim } of both) {
        mesh.visible = thick > 0 && !hidden;
        if (!mesh.visible) continue;
        const out = thick + rim;
        const { array } = mesh.geometry.attributes.position;
        for (let k = 0; k < corners.length; k += 1) array[k] = corners[k] + out * outwards[k];
        // not below the floor, where nobody would see it from above
        for (let k = 2; k < corners.length; k += 3) array[k] = Math.max(array[k], rim ? 0.009 : 0.014);
        mesh.geometry.attributes.position.needsUpdate = true;
      }
    });
  }

  const STOP_PX = 44; // as in stage.css
  /** @type {{x: number, foot: number, width: number, height: number}[]} */
  let signs = [];

  /** The sign stands over the robot wherever it is seen, and on none of it. */
  function pinStop() {
    const project = order && halted ? viser.projector() : null;
    const [edge, top] = [order?.robot_radius ?? 0, order?.robot_height ?? 0];
    const at = project?.(atX, atY, top);
    stop.hidden = !at;
    signs = [];
    if (!project || !at) return;
    const around = [[edge, 0], [-edge, 0], [0, edge], [0, -edge]].map(([dx, dy]) => project(atX + dx, atY + dy, top)?.[1] ?? at[1]);
    const [x, foot] = [at[0], Math.min(...around) - 4];
    stop.style.transform = `translate(${x}px, ${foot}px) translate(-50%, -100%)`;
    signs = [{ x, foot, width: STOP_PX + 4, height: STOP_PX + 4 }];
  }

  function showLegend() {
    const { ink } = window.desirePath;
    if (!order || hidden || !ink.say("reasons.goal")) return void legend.remove();
    const shown = [...(order.objects.some((one) => one.outline) ? ["outline"] : []), ...(rayMesh ? ["free", "hit"] : []), ...(order.attention ? ["sector", "descriptor"] : []), "goal"].filter((name) => ink.say(`reasons.${name}`));
    legend.replaceChildren(...shown.map((name) => {
      const item = document.createElement("li");
      const icon = document.createElement("i");
      icon.className = name;
      item.append(icon, ink.say(`reasons.${name}`));
      return item;
    }));
    window.desirePath.sheet.strip.append(legend);
  }

  window.desirePath.explained = {
    /** The scene's own explanation, null where it has none. @param {Orders["show"]["explained"]} given */
    use(given) {
      order = given;
      attention.use(given?.attention ?? null);
      [row, hidden, halted] = [-1, false, false];
      [hulls, rayMesh, lineMesh] = [[], null, null];
      window.desirePath.picking.stop();
      if (!given) {
        for (const one of [stop, legend]) one.remove();
        return;
      }
      const one = (/** @type {string} */ name) => {
        const [mesh] = name ? viser.meshes(name) : [];
        if (mesh) mesh.frustumCulled = false; // its corners leave the place that they were sent with
        return mesh ?? null;
      };
      [rayMesh, lineMesh] = [one(given.rays), one(given.line)];
      hulls = given.objects.map(({ outline }) => (outline ? viser.meshes(outline) : []).map((mesh, k) => {
        const { position, _mark: outwards } = mesh.geometry.attributes;
        Object.assign(mesh, { visible: false, frustumCulled: false });
        Object.assign(mesh.material, { side: 1, needsUpdate: true }); // the far sides alone
        return { mesh, corners: Float32Array.from(position.array), outwards: Float32Array.from(outwards.array), rim: k ? RIM_M : 0 };
      }));
      stop.hidden = true;
      window.desirePath.sheet.element.append(stop);
      showLegend();
    },

    /** It drives from its start now. */
    begin() {
      window.desirePath.picking.stop();
      this.hide(false);
    },

    /** Before the robot starts: where it is to go. @param {number[]} pose x, y, yaw */
    idle([x, y]) {
      if (!order) return;
      [atX, atY] = [x, y];
      drawLine();
      viser.redraw();
    },

    /** @param {number} t seconds @param {number} x @param {number} y @param {number} yaw the robot is here then */
    at(t, x, y, yaw) {
      if (!order) return;
      [atX, atY] = [x, y];
      const last = order.scores.length - 1;
      const now = Math.max(0, Math.min(last, Math.floor(t / STEP_S + 1e-6)));
      halted = now === last;
      if (now !== row) drawOutlines((row = now));
      if (!hidden) {
        drawRays(yaw);
        attention.at(t, x, y, yaw);
      }
      drawLine();
      pinStop();
    },

    /** Reasons are not shown while objects are ranked; the sign, the goal and the line are. @param {boolean} on */
    hide(on) {
      if (!order) return;
      hidden = on;
      if (rayMesh) rayMesh.visible = !on;
      attention.hide(on);
      if (row >= 0) drawOutlines(row);
      showLegend();
      viser.redraw();
    },

    /** Keeps the sign over the robot when the camera turns. */
    follow: pinStop,
    /** Where the sign is, which nothing else may cover. */
    sign: () => signs,
    /** Where a robot that has halted is, and its sign; null: it drives. */
    halt: () => (order && halted ? { at: [atX, atY, order.robot_height], text: "STOP", on: false } : null),
    objects: () => order?.objects ?? [],
    /** @param {any} message of the page */
    obey(message) {
      if (message.do === "words") {
        window.desirePath.ink.use(message.words);
        showLegend();
      } else window.desirePath.picking.obey(message);
    },
  };
})();
