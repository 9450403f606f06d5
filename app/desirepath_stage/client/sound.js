// @ts-check
/**
 * The sound of the watched robot's motors, where the study offers it: made here, louder and higher the faster it drives or
 * turns, from where it is, heard from where the eyes are, in a headset too. What stands still is silent.
 */
(() => {
  "use strict";
  const { bridge } = window.desirePath;
  const AXLE_M = 0.2; // above the floor, ours as all that follows
  const HUM_HZ = 60;
  const HZ_PER_M_S = 220;
  const HZ_PER_RAD_S = 25;
  const FULL_M_S = 0.5; // at which it is as loud as it gets
  const FULL_RAD_S = 1.5;
  const LOUDEST = 0.2;
  const EASE_S = 0.06;
  const STILL_S = 0.25; // after the last news of it
  const LONGEST_GAP_S = 1; // between two pictures that say how fast it drives
  const JUMP_M = 1; // no robot drives so far between two pictures
  const ASKED_AGAIN_S = 1; // browsers let a page sound only after a press

  /** @type {{on: string, off: string} | null} */
  let words = null;
  let on = false;
  /** @type {{context: AudioContext, hum: OscillatorNode, loudness: GainNode, place: PannerNode} | null} */
  let motor = null;
  /** @type {number[] | null} x, y, yaw and when, s */
  let before = null;
  let asked = -Infinity;

  const button = document.createElement("button");
  Object.assign(button, { id: "desire-path-sound", type: "button", hidden: true });
  window.desirePath.sheet.element.append(button);
  button.addEventListener("pointerdown", (event) => event.stopPropagation()); // beside it the gaze is turned
  button.addEventListener("click", () => turn(!on));

  /** @param {boolean} wanted */
  function turn(wanted) {
    on = wanted;
    before = null;
    if (on) motor ??= build();
    if (motor) void (on ? motor.context.resume() : motor.context.suspend());
    show();
    bridge.post("sound", { on });
  }

  function show() {
    button.hidden = words === null;
    button.setAttribute("aria-pressed", String(on));
    button.textContent = words?.[on ? "off" : "on"] ?? "";
  }

  function build() {
    const context = new AudioContext();
    const hum = new OscillatorNode(context, { type: "sawtooth", frequency: HUM_HZ });
    const dull = new BiquadFilterNode(context, { type: "lowpass", frequency: 700 });
    const loudness = new GainNode(context, { gain: 0 });
    const place = new PannerNode(context, { panningModel: "HRTF", distanceModel: "inverse", refDistance: 1 });
    hum.connect(dull).connect(loudness).connect(place).connect(context.destination);
    hum.start();
    return { context, hum, loudness, place };
  }

  /** The ears are where the eyes are. @param {AudioListener} ears */
  function listen(ears) {
    const m = window.desirePath.viser.eyes();
    const [px, py, pz] = [m[12], m[13], m[14]];
    const [fx, fy, fz, ux, uy, uz] = [-m[8], -m[9], -m[10], m[4], m[5], m[6]];
    if (ears.positionX) {
      [ears.positionX.value, ears.positionY.value, ears.positionZ.value] = [px, py, pz];
      [ears.forwardX.value, ears.forwardY.value, ears.forwardZ.value] = [fx, fy, fz];
      [ears.upX.value, ears.upY.value, ears.upZ.value] = [ux, uy, uz];
    } else { // Firefox
      ears.setPosition(px, py, pz);
      ears.setOrientation(fx, fy, fz, ux, uy, uz);
    }
  }

  window.desirePath.sound = {
    /** The watched robot is there. @param {number} x @param {number} y @param {number} yaw */
    at(x, y, yaw) {
      if (!on || !motor) return;
      const { context, hum, loudness, place } = motor;
      const now = performance.now() / 1000;
      if (context.state !== "running") {
        if (now - asked < ASKED_AGAIN_S) return;
        asked = now;
        void context.resume();
        return;
      }
      const [bx, by, byaw, at] = before ?? [x, y, yaw, now];
      const [gap, way] = [now - at, Math.hypot(x - bx, y - by)];
      if (gap > 0 || !before) before = [x, y, yaw, now];
      const known = gap > 0 && gap < LONGEST_GAP_S && way < JUMP_M;
      const speed = known ? way / gap : 0;
      const turned = known ? Math.abs(Math.atan2(Math.sin(yaw - byaw), Math.cos(yaw - byaw))) / gap : 0;
      const level = Math.min(1, speed / FULL_M_S + turned / FULL_RAD_S);
      const t = context.currentTime;
      hum.frequency.setTargetAtTime(HUM_HZ + HZ_PER_M_S * speed + HZ_PER_RAD_S * turned, t, EASE_S);
      loudness.gain.cancelScheduledValues(t);
      loudness.gain.setTargetAtTime(LOUDEST * level, t, EASE_S);
      loudness.gain.setTargetAtTime(0, t + STILL_S, EASE_S);
      [place.positionX.value, place.positionY.value, place.positionZ.value] = window.desirePath.viser.toView([x, y, AXLE_M]);
      listen(context.listener);
    },

    /** What is heard now, null: nothing was switched on. */
    heard: () => motor && { on, state: motor.context.state, gain: motor.loudness.gain.value, hz: motor.hum.frequency.value,
      place: [motor.place.positionX.value, motor.place.positionY.value, motor.place.positionZ.value] },

    /** @param {{words: {on: string, off: string}, on: boolean}} message from the page: the study has it */
    obey(message) {
      words = message.words;
      if (message.on !== on) turn(message.on);
      show();
    },
  };
})();
