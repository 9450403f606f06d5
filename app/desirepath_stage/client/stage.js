// @ts-check
/** What the server may order (app/desirepath_stage/stage.py): show, play, draw, replay, clear, replaced. One order at a time, in sequence. */
(() => {
  "use strict";
  const { bridge, frames, viser, camera, player, sheet, scheme, bodies, trail, pictures, draw, steer, mirror, walk, explained, headset } = window.desirePath;
  bridge.state.keys = { pen: draw.KEYS, feet: walk.KEYS };
  const [HELD_LOOKS, HELD_EVERY_MS] = [24, 500];
  /** Counts scenes; waiting for one ends when the next comes. */
  let shown = 0;
  /** The scene whose view is held, until something is played in it: a camera that is set is told to the server. */
  let held = 0;
  /** @type {(() => void)[]} */
  let afterReady = [];

  /** @param {Orders["show"]} order */
  function show(order) {
    const mine = ++shown;
    afterReady = [];
    bridge.state.ready = false;
    document.documentElement.dataset.stage = "building";
    sheet.legend([]);
    pictures.use([]);
    draw.stop();
    steer.stop();
    mirror.stop();
    player.use(order.robots, order.person, [...order.stands], order.crowd, order.goal);
    const whenStanding = () => {
      if (mine !== shown) return;
      if (!viser.isUp() || !order.meshes.every((name) => viser.hasMesh(name))) {
        frames.next(whenStanding);
        return;
      }
      viser.plainPicture(order.sharpness);
      bodies.use(order.robots, [order.person, ...order.crowd.map(({ name }) => name)], order.robot_size);
      scheme.use(order.meshes);
      trail.use(order.meshes.find((name) => name.endsWith("/trail")) ?? "");
      camera.use(order.camera);
      const [x, y, yaw] = order.start;
      for (const robot of order.robots) bodies.put(robot, x, y, yaw);
      bodies.put(order.person, order.stands[0], order.stands[1], order.stands[2]);
      explained.use(order.explained);
      explained.idle(order.start);
      if (order.halted) player.end(order.halted);
      // Two more frames, so that what is called ready has been drawn.
      frames.next(() => frames.next(() => {
        if (mine !== shown) return;
        document.documentElement.dataset.stage = "ready";
        bridge.state.ready = true;
        headset.use(order.camera, order.meshes);
        bridge.post("ready", { keys: bridge.state.keys });
        held = mine;
        holdView(mine, HELD_LOOKS);
        for (const next of afterReady.splice(0)) next();
      }));
    };
    whenStanding();
  }

  /** On a slow machine viser puts its own camera over the scene's after it was shown. @param {number} mine @param {number} looks */
  function holdView(mine, looks) {
    if (mine !== shown || mine !== held || !looks) return;
    camera.fit();
    setTimeout(() => holdView(mine, looks - 1), HELD_EVERY_MS);
  }

  /** @param {() => void} action */
  function onceReady(action) {
    if (bridge.state.ready) action();
    else afterReady.push(action);
  }

  window.desirePath.run = (order) => {
    if (order.type === "show") show(order);
    else if (order.type === "play") {
      onceReady(() => {
        held = 0;
        if (order.paper) draw.begin(order.paper);
        draw.rest();
        player.play(order);
      });
    } else if (order.type === "draw") {
      onceReady(() => {
        player.rest(order.start);
        draw.begin(order);
      });
    } else if (order.type === "replay") {
      onceReady(() => {
        camera.release();
        sheet.legend(order.legend);
        pictures.use(order.pictures);
        player.replay(order);
      });
    } else if (order.type === "steer") {
      onceReady(() => steer.obey(order));
    } else if (order.type === "clear") {
      shown += 1;
      afterReady = [];
      bridge.state.ready = false;
      document.documentElement.dataset.stage = "empty";
      player.use([]);
      window.desirePath.finder.rest();
      explained.use(null);
      draw.stop();
      steer.stop();
      mirror.stop();
      sheet.legend([]);
      pictures.use([]);
    } else if (order.type === "replaced") {
      viser.stopReconnecting();
      player.interrupt("replaced");
      bridge.post("replaced");
    }
  };

  const probe = document.createElement("canvas").getContext("webgl2");
  bridge.state.webgl = Boolean(probe);
  if (probe) probe.getExtension("WEBGL_lose_context")?.loseContext();
  else bridge.post("webgl-missing");
})();
