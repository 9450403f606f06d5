// @ts-check
/**
 * The wire to the page that holds this stage: events go up; `hello`, orders for the pen (`draw`), for explained objects
 * (`explain`), paths to drive (`steer`), where a real robot is (`mirror`), a moment of what was played (`still`), what a headset shows (`headset`) and
 * whether motors sound (`sound`) come down.
 * Origins are checked both ways.
 *
 * Every event is `{source: "desirepath-stage", type, ...}`; the types are listed in app/desirepath_stage/page.py.
 */
(() => {
  "use strict";
  const { pageOrigin } = window.desirePathConfig;
  /** @type {DesirePath["bridge"]["state"]} */
  const state = { connected: false, ready: false, webgl: true, playback_id: null };

  /** @param {string} type @param {object} [detail] */
  function post(type, detail = {}) {
    if (window.parent !== window) {
      window.parent.postMessage({ source: "desirepath-stage", type, ...detail }, pageOrigin);
    }
  }

  window.addEventListener("message", (event) => {
    if (event.source !== window.parent || event.origin !== pageOrigin) return;
    if (event.data?.type === "hello") post("state", state);
    else if (event.data?.type === "draw") window.desirePath.draw?.obey(event.data);
    else if (event.data?.type === "steer") window.desirePath.steer?.obey(event.data);
    else if (event.data?.type === "mirror") window.desirePath.mirror?.show(event.data);
    else if (event.data?.type === "headset") window.desirePath.headset?.obey(event.data);
    else if (event.data?.type === "sound") window.desirePath.sound?.obey(event.data);
    else if (event.data?.type === "still") window.desirePath.player?.still(Number(event.data.seconds));
    else if (event.data?.type === "explain") window.desirePath.explained?.obey(event.data);
  });

  document.addEventListener("visibilitychange", () => {
    if (window.desirePath.headset?.worn()) return; // the window is not what is looked at
    if (document.hidden) window.desirePath.player?.interrupt("tab-hidden");
    post(document.hidden ? "tab-hidden" : "tab-visible");
  });

  window.desirePath = Object.assign(window.desirePath ?? {}, { bridge: { post, state } });
})();
