// @ts-check
/**
 * Every private part of viser's page that we lean on (viser 1.1.1; the server's side is app/desirepath_stage/viser_hooks.py):
 * its websocket worker, its retry rule, `window.__viserMutable`, and the renderer behind react-three-fiber.
 */
(() => {
  "use strict";
  const { bridge } = window.desirePath;
  let replaced = false;
  let cameraReported = false;
  let lost = false;

  // viser only reconnects while its document has the focus; ours sits in an iframe that rarely has it.
  document.hasFocus = () => !replaced;

  /** @param {{type?: string}} data what viser's worker says about its websocket */
  function fromWorker(data) {
    if (data?.type === "connected") {
      cameraReported = false;
      lost = false;
      bridge.state.connected = true;
      document.documentElement.dataset.link = "up";
      bridge.post("connected");
    } else if (data?.type === "closed" && !lost) {
      lost = true; // once per loss, not once per attempt; also when the very first attempt fails
      bridge.state.connected = false;
      bridge.state.ready = false;
      document.documentElement.dataset.link = "lost";
      window.desirePath.player.interrupt("connection-lost");
      if (!replaced) bridge.post("connection-lost");
    }
  }

  // viser's websocket lives in a worker. Listening in tells us about the connection, and stops the camera reports
  // (50 a second during playback) after the one that viser needs to count this client as connected.
  const NativeWorker = window.Worker;
  window.Worker = class extends NativeWorker {
    /** @param {string | URL} url @param {WorkerOptions} [options] */
    constructor(url, options) {
      super(url, options);
      this.addEventListener("message", (event) => fromWorker(event.data));
    }

    /** @param {any} message @param {any} [transfer] */
    postMessage(message, transfer) {
      if (message?.type === "send") {
        if (message.message?.type !== "ViewerCameraMessage" || cameraReported) return;
        cameraReported = true;
      }
      super.postMessage(message, transfer);
    }
  };

  const mutable = () => window.__viserMutable;

  // Corners of a figure are marked with part, side and height (app/desirepath_stage/bodies.py): shins bend at the knee while the leg goes
  // forward, thighs and shins swing about the hip, arms the other way about the shoulder.
  const GAIT = `
    vec3 transformed = position;
    if (_mark.x > 0.5) {
      float beat = gait.x + (_mark.y > 0.0 ? 0.0 : 3.14159265);
      float tall = _mark.z / 1.7;
      vec2 limb = transformed.xz;
      if (abs(_mark.x - 2.0) < 0.5) {
        float bent = -0.95 * gait.y * max(0.0, cos(beat));
        vec2 knee = vec2(0.018, 0.49) * tall;
        limb = knee + mat2(cos(bent), sin(bent), -sin(bent), cos(bent)) * (limb - knee);
      }
      float swung = (_mark.x > 2.5 ? -0.4 : 0.5) * gait.y * sin(beat);
      vec2 joint = vec2(0.0, _mark.x > 2.5 ? 1.355 : 0.88) * tall;
      transformed.xz = joint + mat2(cos(swung), sin(swung), -sin(swung), cos(swung)) * (limb - joint);
    }`;

  /** @param {number[]} point world metres, z up @returns {any} three.js vector in viser's y-up world */
  function vector(point) {
    const { camera, nodeRefFromName } = mutable();
    return camera.position.clone().set(...point).applyQuaternion(nodeRefFromName[""].quaternion);
  }

  window.desirePath.viser = {
    /** Whether viser's page stands so far that a camera can be set. */
    isUp: () => Boolean(mutable()?.cameraControl && mutable().camera && mutable().nodeRefFromName[""]),

    /** @param {string} name @returns {boolean} whether the node is in the scene with its mesh decoded */
    hasMesh(name) {
      let found = false;
      mutable()?.nodeRefFromName[name]?.traverse((/** @type {any} */ part) => { found ||= Boolean(part.isMesh); });
      return found;
    },

    /** @param {string} name @param {number} x @param {number} y @param {number} yaw */
    pose(name, x, y, yaw) {
      const pose = mutable()?.nodePoseData[name];
      if (!pose) return;
      pose.position = [x, y, 0];
      pose.wxyz = [Math.cos(yaw / 2), 0, 0, Math.sin(yaw / 2)];
      pose.poseUpdateState = "needsUpdate";
      mutable().requestRender();
    },

    /** @param {{eye: number[], target: number[], up: number[], fovRad: number, near?: number}} view metres, radians */
    look({ eye, target, up, fovRad, near = 0.05 }) {
      const { camera, cameraControl } = mutable();
      const upward = vector(up);
      if (camera.up.distanceToSquared(upward) > 1e-9) {
        camera.up.copy(upward);
        cameraControl.updateCameraUp();
      }
      const degrees = (fovRad * 180) / Math.PI;
      if (Math.abs(camera.fov - degrees) > 1e-6 || camera.near !== near) {
        camera.fov = degrees;
        camera.near = near;
        camera.far = Math.max(400, 4 * near);
        camera.updateProjectionMatrix();
      }
      const from = vector(eye);
      const to = vector(target);
      cameraControl.setLookAt(from.x, from.y, from.z, to.x, to.y, to.z, false);
      mutable().requestRender();
    },

    /** How the floor is seen now: a function from world metres to this window's pixels, null for what is behind the eye.
     * @returns {(x: number, y: number, z?: number) => number[] | null} */
    projector() {
      const { camera, nodeRefFromName } = mutable();
      camera.updateMatrixWorld();
      const seen = camera.matrixWorldInverse.clone().premultiply(camera.projectionMatrix);
      const m = seen.multiply(nodeRefFromName[""].matrixWorld).elements;
      return (x, y, z = 0) => {
        const w = m[3] * x + m[7] * y + m[11] * z + m[15];
        if (w < camera.near) return null;
        const right = (m[0] * x + m[4] * y + m[8] * z + m[12]) / w;
        const up = (m[1] * x + m[5] * y + m[9] * z + m[13]) / w;
        return [((right + 1) / 2) * window.innerWidth, ((1 - up) / 2) * window.innerHeight];
      };
    },

    /** The place on the floor under a pixel, null above the horizon. @param {number} px @param {number} py */
    floorAt(px, py) {
      const { eye, along } = this.ray(px, py);
      if (along[2] > -1e-9) return null;
      const reach = -eye[2] / along[2];
      return [eye[0] + reach * along[0], eye[1] + reach * along[1]];
    },

    /** Where the eye is and which way it looks through a pixel, world metres. @param {number} px @param {number} py */
    ray(px, py) {
      const { camera, nodeRefFromName } = mutable();
      const back = nodeRefFromName[""].quaternion.clone().invert();
      const eye = camera.position.clone().applyQuaternion(back);
      const along = camera.position.clone()
        .set((px / window.innerWidth) * 2 - 1, 1 - (py / window.innerHeight) * 2, 0.5)
        .unproject(camera).applyQuaternion(back).sub(eye);
      return { eye: [eye.x, eye.y, eye.z], along: [along.x, along.y, along.z] };
    },

    /** The three.js meshes of a node, whose corners our scripts may move. @param {string} name @returns {any[]} */
    meshes(name) {
      /** @type {any[]} */
      const found = [];
      mutable()?.nodeRefFromName[name]?.traverse((/** @type {any} */ part) => part.isMesh && found.push(part));
      return found;
    },
    /** A node's colours so many times as bright, and a figure's. @param {string} name @param {number} factor @param {number} figure */
    tint(name, factor, figure) {
      for (const { material, userData } of this.meshes(name)) material.color?.setScalar(userData.walks ? figure : factor);
    },

    /**
     * Lets a figure of `bodies.mannequin` walk. @param {string} name
     * @returns {number[]} its gait: where in a stride it is, radians, and how far limbs swing, 0 to 1; may be changed
     */
    gait(name) {
      const gait = [0, 0];
      for (const mesh of this.meshes(name)) {
        if (!mesh.geometry.attributes._mark) continue;
        mesh.material.onBeforeCompile = (/** @type {any} */ shader) => {
          shader.uniforms.gait = { value: gait };
          shader.vertexShader = `uniform vec2 gait;\nattribute vec3 _mark;\n${shader.vertexShader.replace("#include <begin_vertex>", GAIT)}`;
        };
        mesh.material.customProgramCacheKey = () => "gait";
        mesh.material.needsUpdate = mesh.userData.walks = true;
      }
      return gait;
    },
    redraw: () => mutable().requestRender(),

    /** three.js's renderer and the root of all that it draws, for a headset. @returns {{gl: any, root: any}} */
    drawing() {
      let root = mutable().scene;
      while (root.parent) root = root.parent;
      return { gl: root.__r3f?.root?.getState()?.gl, root };
    },
    /** Where the eyes are and which way they look, in a headset too, as three.js has it. @returns {number[]} a matrix, by columns */
    eyes() {
      const { gl } = this.drawing();
      return (gl?.xr.isPresenting ? gl.xr.getCamera() : mutable().camera).matrixWorld.elements;
    },
    /** Where meshes in world metres, z up, belong. @returns {any} */
    world: () => mutable().nodeRefFromName[""],
    /** A place or a way in world metres, as three.js and headsets have it, y up. @param {number[]} point @returns {number[]} */
    toView: (point) => vector(point).toArray(),
    /** And back. @param {number[]} point @returns {number[]} */
    fromView(point) {
      const { camera, nodeRefFromName } = mutable();
      return camera.position.clone().set(...point).applyQuaternion(nodeRefFromName[""].quaternion.clone().invert()).toArray();
    },
    /**
     * Draws for a headset, or for the window again. What three.js takes over from a headset knows no reversed depth, with
     * which viser draws (r186): what is farther would cover what is nearer.
     * @param {number[] | null} colour 0 to 1, behind everything, where no page shines through; null: the window
     */
    wear(colour) {
      const { gl } = this.drawing();
      gl.state.buffers.depth.setReversed(!colour && gl.capabilities.reversedDepthBuffer);
      if (!colour) mutable().camera.updateProjectionMatrix();
      const mixed = gl.getClearColor(this.meshes("")[0].material.color.clone());
      gl.setClearColor(mixed.setRGB(...(colour ?? [0, 0, 0])), colour ? 1 : 0);
    },

    /** @param {boolean} free whether viser's own controls may turn the camera: above the floor, never under it */
    orbit(free) {
      mutable().cameraControl.maxPolarAngle = free ? 1.45 : Math.PI;
    },

    /**
     * Colours as they were baked, without any conversion; and not the empty background that viser draws over all.
     * @param {number} sharpness pixels drawn per pixel of the screen, in each direction
     */
    plainPicture(sharpness) {
      const { backgroundMaterial } = mutable();
      const { gl: renderer, root } = this.drawing();
      if (!renderer?.xr.isPresenting) root.__r3f?.root?.getState()?.setDpr(sharpness * window.devicePixelRatio);
      if (renderer) Object.assign(renderer, { toneMapping: 0, outputColorSpace: "srgb-linear" });
      root.traverse((/** @type {any} */ part) => {
        if (part.material?.map?.colorSpace) {
          part.material.map.colorSpace = "";
          part.material.map.needsUpdate = part.material.needsUpdate = true;
        }
        if (part.material === backgroundMaterial) part.visible = false;
      });
    },

    /** After another connection took over: stay away. */
    stopReconnecting() {
      replaced = true;
      window.dispatchEvent(new Event("blur"));
    },
  };

  // Capture phase, because these events do not bubble.
  document.addEventListener("webglcontextlost", () => {
    document.documentElement.dataset.webgl = "lost";
    window.desirePath.player.interrupt("webgl-lost");
    bridge.post("webgl-lost");
  }, true);
  document.addEventListener("webglcontextrestored", () => {
    delete document.documentElement.dataset.webgl;
    bridge.post("webgl-restored");
  }, true);
})();
