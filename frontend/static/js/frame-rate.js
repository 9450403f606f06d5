// @ts-check
/**
 * How many pictures a second this device draws: for a second, something about as heavy as the room is drawn on a canvas
 * that nobody sees. Measured before anybody is asked for consent, so that no one begins what their device cannot show.
 */

const MEASURED_MS = 1000;
const WARM_UP_FRAMES = 4; // the first pictures of a page pay for what later ones do not
const PATIENCE_MS = 6000; // then what was drawn so far counts; of a window in the background nothing is known
/** As many triangles as a room with its person and robot (9,300), see app/desirepath_stage/bodies.py. */
const RINGS = 97;
const SEGMENTS = 48;

const VERTEX = `#version 300 es
in vec2 at; uniform float time; uniform float aspect; out vec2 uv; out float light;
void main() {
  float around = at.x * 6.2832; float along = at.y * 6.2832;
  vec3 normal = vec3(cos(around) * cos(along), sin(along), sin(around) * cos(along));
  vec3 p = vec3(cos(around), 0.0, sin(around)) * 1.6 + normal * 0.7;
  float c = cos(time), s = sin(time);
  p = vec3(c * p.x + s * p.z, p.y * 0.5 - 0.2, c * p.z - s * p.x - 4.0);
  uv = at * 8.0; light = 0.6 + 0.4 * normal.y;
  gl_Position = vec4(p.x * 1.6 / aspect, p.y * 1.6, -p.z - 0.2, -p.z);
}`;
const FRAGMENT = `#version 300 es
precision mediump float; in vec2 uv; in float light; uniform sampler2D floorPicture; out vec4 colour;
void main() { colour = vec4(texture(floorPicture, uv).rgb * light, 1.0); }`;
const BACKGROUND = `#version 300 es
in vec2 at; uniform float time; uniform float aspect; out vec2 uv; out float light;
void main() { uv = at * 6.0 + time * 0.01; light = 1.0; gl_Position = vec4(at * 2.0 - 1.0, 0.99, 1.0); }`;

/**
 * @param {number} width CSS pixels of the picture @param {number} height
 * @returns {Promise<number | null>} pictures a second, null where it could not be measured
 */
export async function frameRate(width, height) {
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  const gl = canvas.getContext("webgl2", { antialias: true });
  if (!gl) return null;
  try {
    return await measured(gl);
  } finally {
    gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** @param {WebGL2RenderingContext} gl @returns {Promise<number | null>} */
function measured(gl) {
  const draw = readyRoom(gl);
  const pixel = new Uint8Array(4);
  let frames = 0;
  let warm = false;
  let began = performance.now();
  return new Promise((done) => {
    setTimeout(() => done(document.hidden ? null : (frames * 1000) / (performance.now() - began)), PATIENCE_MS);
    const step = () => {
      draw(performance.now() / 1000);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel); // waits until the picture is really drawn
      frames += 1;
      const now = performance.now();
      if (!warm && frames === WARM_UP_FRAMES) [warm, began, frames] = [true, now, 0];
      if (warm && now - began >= MEASURED_MS) done((frames * 1000) / (now - began));
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  });
}

/** @param {WebGL2RenderingContext} gl @returns {(time: number) => void} draws one picture */
function readyRoom(gl) {
  const body = program(gl, VERTEX);
  const ground = program(gl, BACKGROUND);
  /** @type {number[]} */
  const corners = [];
  for (let r = 0; r < RINGS; r++) {
    for (let s = 0; s < SEGMENTS; s++) {
      const [x, y, x1, y1] = [r / RINGS, s / SEGMENTS, (r + 1) / RINGS, (s + 1) / SEGMENTS];
      corners.push(x, y, x1, y, x1, y1, x, y, x1, y1, x, y1);
    }
  }
  const bodyCount = corners.length / 2;
  corners.push(0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
  const side = 512;
  const picture = new Uint8Array(side * side * 4).map((_, i) => 150 + ((i * 2654435761) >>> 27));
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, side, side, 0, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  gl.generateMipmap(gl.TEXTURE_2D);
  gl.enable(gl.DEPTH_TEST);
  gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
  const aspect = gl.drawingBufferWidth / gl.drawingBufferHeight;
  return (time) => {
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const [used, first, count] of /** @type {[WebGLProgram, number, number][]} */ ([[ground, bodyCount, 6], [body, 0, bodyCount]])) {
      gl.useProgram(used);
      gl.uniform1f(gl.getUniformLocation(used, "time"), time);
      gl.uniform1f(gl.getUniformLocation(used, "aspect"), aspect);
      gl.drawArrays(gl.TRIANGLES, first, count);
    }
  };
}

/** @param {WebGL2RenderingContext} gl @param {string} vertex @returns {WebGLProgram} */
function program(gl, vertex) {
  const made = /** @type {WebGLProgram} */ (gl.createProgram());
  for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.bindAttribLocation(made, 0, "at");
  gl.linkProgram(made);
  return made;
}
