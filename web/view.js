// The page that shows a drive. Frames come from the decoder, which web/build.js puts into the page, or from what
// `lidarpc view --html` writes into it.

const $ = (id) => document.getElementById(id);
const embedded = $("drive");
const decodes = $("module") !== null;

/** Frames that are kept, and frames that are decoded ahead while the drive plays. */
const KEPT = 24;
const AHEAD = 3;
/** Milliseconds from frame to frame where no times are known, and the longest that a known one lasts. */
const TURN = 100;
const LONGEST = 1000;

const number = new Intl.NumberFormat("en");
const bytesOf = (base64) => Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));

function size(bytes) {
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  let unit = 0;
  while (bytes >= 1000 && unit < units.length - 1) [bytes, unit] = [bytes / 1000, unit + 1];
  return `${unit === 0 ? bytes : bytes.toPrecision(3)} ${units[unit]}`;
}

// ---- where frames come from

/** The decoder in a worker. */
class Decoder {
  #calls = new Map();
  #worker;
  #ready;

  constructor() {
    const source = URL.createObjectURL(new Blob([$("worker").textContent], { type: "text/javascript" }));
    this.#worker = new Worker(source);
    this.#worker.onmessage = ({ data: { id, result, error } }) => {
      const { resolve, reject } = this.#calls.get(id);
      this.#calls.delete(id);
      if (error === undefined) resolve(result);
      else reject(new Error(error));
    };
    this.#worker.onerror = (event) => {
      const error = new Error(`the decoder cannot be started: ${event.message ?? "the browser refuses workers"}`);
      for (const { reject } of this.#calls.values()) reject(error);
      this.#calls.clear();
    };
    this.#ready = this.#call("begin", bytesOf($("module").textContent));
  }

  #call(call, argument) {
    return new Promise((resolve, reject) => {
      const id = crypto.getRandomValues(new Uint32Array(2)).join();
      this.#calls.set(id, { resolve, reject });
      this.#worker.postMessage({ id, call, argument });
    });
  }

  /** A file, or the text of a URL. */
  async open(input) {
    await this.#ready;
    const drive = await this.#call("open", input);
    const [scanner, ...others] = drive.scanners;
    const more = others.length > 0 ? ` and ${others.length} more` : "";
    const about = [drive.name, frames(drive.length), size(drive.byteLength), scanner ? scanner + more : null];
    return {
      length: drive.length,
      about: about.filter(Boolean).join(", "),
      times: drive.frames.map(({ time }) => time),
      frame: (place) => this.#call("frame", place),
    };
  }
}

/** What the program wrote into the page: a table of the drive, and in an element for each frame its points, compressed. */
function written() {
  const drive = JSON.parse(embedded.textContent);
  const elements = document.querySelectorAll("script.frame");
  return {
    length: drive.frames.length,
    about: [drive.name, frames(drive.frames.length), size(drive.bytes), ...drive.scanners.slice(0, 1)].join(", "),
    times: drive.frames.map(({ time }) => (time === null ? null : BigInt(time))),
    async frame(place) {
      const about = drive.frames[place];
      const inflated = new Blob([bytesOf(elements[place].textContent)]).stream().pipeThrough(new DecompressionStream("deflate"));
      return unpacked(about, new Uint8Array(await new Response(inflated).arrayBuffer()));
    },
  };
}

const frames = (count) => `${number.format(count)} ${count === 1 ? "frame" : "frames"}`;

/**
 * The points of a frame as `src/cli/view/page.rs` packs them: 16-bit numbers as differences from one point to the next, the low
 * bytes of all points, then the high ones: x, y and z in units, row and column of the range image; then 8 bits a field.
 */
function unpacked(about, bytes) {
  const { points, unit, rows, columns, fields } = about;
  let at = 0;
  const plane = () => {
    const values = new Uint16Array(points);
    for (let point = 0, value = 0; point < points; point++) {
      value += bytes[at + point] | (bytes[at + points + point] << 8);
      values[point] = value;
    }
    at += 2 * points;
    return values;
  };
  const axes = [plane(), plane(), plane()].map((plane) => new Int16Array(plane.buffer));
  const [row, column] = [plane(), plane()];
  const positions = new Float32Array(3 * points);
  for (let point = 0; point < points; point++) {
    // What is not finite has no number.
    const isPoint = axes[0][point] !== -32768;
    for (let axis = 0; axis < 3; axis++) positions[3 * point + axis] = isPoint ? axes[axis][point] * unit : NaN;
  }
  const named = {};
  for (const { name, least, step } of fields) {
    named[name] = Float32Array.from(bytes.subarray(at, at + points), (value) => least + value * step);
    at += points;
  }
  const cells = new Int32Array(rows * columns).fill(-1);
  for (let point = 0; point < points; point++) {
    if (row[point] < rows) cells[row[point] * columns + column[point]] = point;
  }
  const rangeImage = rows > 0 ? { rows, columns, points: cells } : null;
  return { ...about, length: points, positions, fields: named, rangeImage };
}

// ---- colours

/** From small to large: 256 colours of A. Mikhailov's "turbo" (2019), by its polynomials. */
const COLOURS = Uint8Array.from({ length: 256 * 4 }, (_, place) => {
  // Its darkest do not show on the page.
  const x = 0.07 + (0.93 * (place >> 2)) / 255;
  const polynomial = [
    [0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
    [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
    [0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
    [1],
  ][place & 3];
  return 255 * Math.min(1, Math.max(0, polynomial.reduceRight((sum, factor) => sum * x + factor, 0)));
});

/** What fields of lasers are called. */
const RINGS = ["ring", "channel", "laser", "laser_id", "line"];

/** What points can be coloured by: a name to a function of the frame that gives a value for each point. */
function colourings(frame) {
  const found = new Map();
  const { positions, fields, rangeImage, length } = frame;
  const each = (value) => Float32Array.from({ length }, (_, point) => value(3 * point));
  if (positions.length > 0) {
    found.set("height", () => each((at) => positions[at + 2]));
    found.set("range", () => each((at) => Math.hypot(positions[at], positions[at + 1], positions[at + 2])));
  }
  if (rangeImage && !RINGS.some((name) => name in fields)) {
    found.set("ring", () => {
      const rings = new Float32Array(length).fill(NaN);
      rangeImage.points.forEach((point, cell) => {
        if (point >= 0) rings[point] = Math.floor(cell / rangeImage.columns);
      });
      return rings;
    });
  }
  for (const name of Object.keys(fields)) {
    // Fields with several values a point are no colours.
    if (fields[name].length === length && !["x", "y", "z"].includes(name)) {
      found.set(name, () => Float32Array.from(fields[name], Number));
    }
  }
  return found;
}

/** What most values lie between: all but the outermost hundredth on each side. */
function limits(values) {
  const step = Math.max(1, Math.floor(values.length / 20000));
  const sample = values.filter((value, place) => place % step === 0 && Number.isFinite(value)).sort();
  if (sample.length === 0) return [0, 1];
  const [least, most] = [sample[Math.floor(sample.length / 100)], sample[Math.floor((sample.length * 99) / 100)]];
  return least < most ? [least, most] : [sample[0], Math.max(sample.at(-1), sample[0] + 1e-6)];
}

/** Whether a point is a return: records without one have no numbers, or zeros. */
function isReturn(positions, point) {
  const [x, y, z] = [positions[3 * point], positions[3 * point + 1], positions[3 * point + 2]];
  return Number.isFinite(x + y + z) && (x !== 0 || y !== 0 || z !== 0);
}

// ---- points in space

const VERTEX = `
attribute vec3 position;
attribute float value;
uniform mat4 camera;
uniform vec2 limits;
uniform float size;
varying float part;
void main() {
  gl_Position = camera * vec4(position, 1.0);
  gl_PointSize = size;
  part = clamp((value - limits.x) / (limits.y - limits.x), 0.0, 1.0);
}`;

const FRAGMENT = `
precision mediump float;
uniform sampler2D colours;
varying float part;
void main() { gl_FragColor = texture2D(colours, vec2(part * (255.0 / 256.0) + 0.5 / 256.0, 0.5)); }`;

/** Draws points, seen from a camera that turns around what it looks at. */
class Space {
  /** Radians, metres. */
  #turn;
  #tilt;
  #distance;
  #target;
  /** Metres: from where all is seen. */
  #away = 45;
  #count = 0;
  #limits = [0, 1];
  #isDue = false;
  #pointers = new Map();
  size = 2;

  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl", { antialias: false });
    if (!gl) throw new Error("the browser has no WebGL, which draws the points");
    this.gl = gl;
    this.#begin();
    this.reset();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.#begin();
      this.onrestored?.();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.#pointers.set(event.pointerId, event);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => this.#pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.#come(Math.exp(event.deltaY * (event.deltaMode === 1 ? 0.04 : 0.0015)));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
  }

  /** Looks at the scanner from behind and above. */
  reset() {
    [this.#turn, this.#tilt, this.#distance, this.#target] = [-2.1, 0.55, this.#away, [0, 0, 0]];
    this.draw();
  }

  /** The same, from where most of these points are seen. */
  fit(positions) {
    const step = 3 * Math.max(1, Math.floor(positions.length / 30000));
    const ranges = [];
    for (let at = 0; at < positions.length; at += step) {
      if (isReturn(positions, at / 3)) ranges.push(Math.hypot(positions[at], positions[at + 1], positions[at + 2]));
    }
    ranges.sort((one, other) => one - other);
    this.#away = Math.max(1, Math.round(2.6 * (ranges[Math.floor(ranges.length * 0.75)] ?? 20)));
    this.reset();
  }

  #begin() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`the points cannot be drawn: ${gl.getProgramInfoLog(program)}`);
    }
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.063, 0.078, 0.094, 1);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, COLOURS);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    this.uniform = (name) => gl.getUniformLocation(program, name);
    this.buffers = { position: 3, value: 1 };
    for (const [name, width] of Object.entries(this.buffers)) {
      const place = gl.getAttribLocation(program, name);
      this.buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    }
    this.#count = 0;
  }

  /** Draws points, coloured by these values; tells how many are returns. */
  show(positions, values, limits) {
    const { gl } = this;
    const [places, shown] = [new Float32Array(positions.length), new Float32Array(values.length)];
    let count = 0;
    for (let point = 0; point < values.length; point++) {
      if (!isReturn(positions, point)) continue;
      for (let axis = 0; axis < 3; axis++) places[3 * count + axis] = positions[3 * point + axis];
      shown[count++] = Number.isFinite(values[point]) ? values[point] : limits[0];
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.position);
    gl.bufferData(gl.ARRAY_BUFFER, places.subarray(0, 3 * count), gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.value);
    gl.bufferData(gl.ARRAY_BUFFER, shown.subarray(0, count), gl.DYNAMIC_DRAW);
    [this.#count, this.#limits] = [count, limits];
    this.draw();
    return count;
  }

  draw() {
    if (this.#isDue) return;
    this.#isDue = true;
    requestAnimationFrame(() => {
      this.#isDue = false;
      this.#drawNow();
    });
  }

  #drawNow() {
    const { gl, canvas } = this;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth * scale, canvas.clientHeight * scale].map(Math.round);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.uniform("camera"), false, this.#camera(width / Math.max(1, height)));
    gl.uniform2f(this.uniform("limits"), ...this.#limits);
    gl.uniform1f(this.uniform("size"), this.size * scale);
    gl.drawArrays(gl.POINTS, 0, this.#count);
  }

  /** Right, up and back, as seen by the camera. */
  #axes() {
    const [ct, st, ce, se] = [Math.cos(this.#turn), Math.sin(this.#turn), Math.cos(this.#tilt), Math.sin(this.#tilt)];
    return [[-st, ct, 0], [-se * ct, -se * st, ce], [ce * ct, ce * st, se]];
  }

  /** World to screen, column after column. */
  #camera(aspect) {
    const axes = this.#axes();
    const back = axes[2];
    const eye = this.#target.map((value, axis) => value + this.#distance * back[axis]);
    const [near, far] = [this.#distance * 0.01, this.#distance * 4 + 500];
    const focus = 1 / Math.tan(0.45);
    const rows = axes.map((axis) => [...axis, -axis.reduce((sum, value, place) => sum + value * eye[place], 0)]);
    const [right, up, depth] = rows;
    const screen = [
      right.map((value) => (value * focus) / aspect),
      up.map((value) => value * focus),
      depth.map((value, place) => ((far + near) * value + (place === 3 ? 2 * far * near : 0)) / (near - far)),
      depth.map((value) => -value),
    ];
    return Float32Array.from({ length: 16 }, (_, place) => screen[place & 3][place >> 2]);
  }

  #drag(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (this.#pointers.size === 2) {
      const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, pointer]) => pointer);
      const apart = (pointer) => Math.hypot(pointer.clientX - other.clientX, pointer.clientY - other.clientY);
      this.#come(apart(before) / Math.max(1, apart(event)));
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
      const [right, up] = this.#axes();
      const metres = (2 * this.#distance * Math.tan(0.45)) / this.canvas.clientHeight;
      this.#target = this.#target.map((value, axis) => value + metres * (dy * up[axis] - dx * right[axis]));
    } else {
      this.#turn -= dx * 0.006;
      this.#tilt = Math.min(1.57, Math.max(-1.57, this.#tilt + dy * 0.006));
    }
    this.#pointers.set(event.pointerId, event);
    this.draw();
  }

  #come(factor) {
    this.#distance = Math.min(2000, Math.max(0.5, this.#distance * factor));
    this.draw();
  }
}

// ---- the page

let space;
let decoder;
let drive = null;
/** The frame that is asked for, and the one that is shown. */
let place = 0;
let shown = null;
let isPlaying = false;
/** Counts drives, so that what comes late for the one before is not shown. */
let drives = 0;
/** Frames under way and decoded, the last used last. */
const kept = new Map();
/** The last of those under way. */
let pending = null;

function fail(error) {
  $("error").textContent = error?.message ?? String(error);
  $("error").hidden = false;
}

async function show(opening, name) {
  const mine = ++drives;
  stop();
  $("error").hidden = true;
  $("hint").textContent = `Opening ${name} …`;
  try {
    const opened = await opening();
    if (mine !== drives) return;
    if (opened.length === 0) throw new Error(`${name}: holds no frames`);
    drive = opened;
  } catch (error) {
    if (mine !== drives) return;
    if (drive) $("hint").textContent = "";
    else invite();
    return fail(error);
  }
  kept.clear();
  pending = null;
  shown = null;
  $("hint").textContent = "";
  $("about").textContent = $("about").title = drive.about;
  $("place").max = drive.length - 1;
  for (const id of ["place", "play", "back", "next", "colour"]) $(id).disabled = false;
  await go(0);
}

/** A frame, decoded once. */
function frameAt(at) {
  let frame = kept.get(at);
  if (frame) {
    kept.delete(at);
  } else {
    frame = drive.frame(at);
    // A damaged frame may be asked for again; what is decoded ahead complains when its turn comes.
    frame.catch(() => kept.delete(at));
    pending = frame;
    const ended = () => pending === frame && (pending = null);
    frame.then(ended, ended);
  }
  kept.set(at, frame);
  for (const oldest of kept.keys()) {
    if (kept.size <= KEPT) break;
    kept.delete(oldest);
  }
  return frame;
}

/** Shows a frame. */
async function go(to) {
  place = Math.min(drive.length - 1, Math.max(0, to));
  $("place").value = place;
  const [mine, at] = [drives, place];
  try {
    // Of frames that are asked for faster than they come, only the last is decoded.
    while (pending && !kept.has(at)) {
      await pending.catch(() => {});
      if (mine !== drives || at !== place) return;
    }
    const frame = await frameAt(at);
    if (mine !== drives || at !== place) return;
    $("error").hidden = true;
    if (!shown) space.fit(frame.positions);
    shown = frame;
    paint();
  } catch (error) {
    if (mine !== drives || at !== place) return;
    fail(error);
    describe({ name: "not decoded", length: null });
  }
}

function describe({ length, name, bytes, codedBytes }) {
  const parts = [`${place + 1} / ${drive.length}`, name];
  if (length !== null) parts.push(`${number.format(length)} points`);
  if (bytes > 0) parts.push(`${size(bytes)} → ${size(codedBytes)}, ${((100 * codedBytes) / bytes).toFixed(1)} %`);
  $("frame").textContent = parts.filter(Boolean).join(" · ");
}

/** Draws the frame that is shown. */
function paint() {
  const found = colourings(shown);
  const names = [...found.keys()];
  if (names.join() !== [...$("colour").options].map(({ value }) => value).join()) {
    const chosen = $("colour").value;
    $("colour").replaceChildren(...names.map((name) => new Option(name)));
    $("colour").value = names.includes(chosen) ? chosen : (names[0] ?? "");
  }
  const name = $("colour").value;
  const values = found.get(name)?.() ?? new Float32Array(shown.length);
  const between = limits(values);
  const points = space.show(shown.positions, shown.positions.length > 0 ? values : [], between);
  paintImage(shown, values, between);
  $("legend").hidden = names.length === 0;
  [$("least").textContent, $("most").textContent] = between.map((value) => `${Number(value.toPrecision(3))}`);
  describe(shown);
  $("hint").textContent = points > 0 ? "" : "no points in this frame";
  // For tests.
  document.body.dataset.frame = shown.number;
  document.body.dataset.points = points;
}

function paintImage({ rangeImage, positions }, values, [least, most]) {
  const canvas = $("image");
  canvas.hidden = !rangeImage;
  if (!rangeImage) return;
  const { rows, columns, points } = rangeImage;
  [canvas.width, canvas.height] = [columns, rows];
  const image = new ImageData(columns, rows);
  const pixels = new Uint32Array(image.data.buffer);
  const colours = new Uint32Array(COLOURS.buffer);
  // Above zero if the lasers that look up are the last rows, which belong on top.
  let rising = 0;
  points.forEach((point, cell) => {
    if (point < 0 || !isReturn(positions, point)) return;
    const part = Math.min(1, Math.max(0, (values[point] - least) / (most - least)));
    pixels[cell] = colours[Math.round(255 * part) || 0];
    const [x, y, z] = [positions[3 * point], positions[3 * point + 1], positions[3 * point + 2]];
    rising += (z / Math.hypot(x, y, z)) * (Math.floor(cell / columns) - (rows - 1) / 2);
  });
  if (rising > 0) {
    for (let row = 0; row < rows >> 1; row++) {
      const [one, other] = [row, rows - 1 - row].map((row) => pixels.slice(row * columns, (row + 1) * columns));
      pixels.set(other, row * columns);
      pixels.set(one, (rows - 1 - row) * columns);
    }
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
}

function stop() {
  isPlaying = false;
  $("play").textContent = "Play";
}

/** How long a frame lasts, in milliseconds. */
function duration(at) {
  const [time, next] = [drive.times[at], drive.times[at + 1]];
  const known = time != null && next != null ? Number(next - time) / 1e6 : 0;
  return known > 0 ? Math.min(LONGEST, known) : TURN;
}

async function play() {
  if (isPlaying) return stop();
  isPlaying = true;
  $("play").textContent = "Pause";
  const mine = drives;
  if (place === drive.length - 1) await go(0);
  while (isPlaying && mine === drives && place < drive.length - 1) {
    const [begun, from] = [performance.now(), place];
    for (let ahead = 1; ahead <= AHEAD; ahead++) {
      if (from + ahead < drive.length) frameAt(from + ahead).catch(() => {});
    }
    await frameAt(from + 1).catch(() => {});
    await new Promise((resolve) => setTimeout(resolve, duration(from) - (performance.now() - begun)));
    // Somebody may have gone elsewhere meanwhile.
    if (isPlaying && mine === drives) await go(place + 1);
  }
  if (mine === drives) stop();
}

function invite() {
  const hint = $("hint");
  hint.replaceChildren();
  const [title, text] = [document.createElement("b"), document.createElement("span")];
  title.textContent = decodes ? "Drop a .lpc file here" : "This page is not built";
  text.textContent = decodes ? "It is decoded in this page; nothing is uploaded." : "web/build.js puts the decoder into it.";
  hint.append(title, text);
}

function openFile(file) {
  return show(() => decoder.open(file), file.name);
}

function begin() {
  const scale = $("scale").getContext("2d");
  scale.putImageData(new ImageData(Uint8ClampedArray.from(COLOURS), 256, 1), 0, 0);
  space = new Space($("points"));
  space.onrestored = () => shown && paint();
  space.draw();

  $("colour").addEventListener("change", () => shown && paint());
  $("size").addEventListener("change", () => {
    space.size = Number($("size").value);
    space.draw();
  });
  space.size = Number($("size").value);
  $("place").addEventListener("input", () => go(Number($("place").value)));
  const step = (by) => {
    stop();
    go(place + by);
  };
  $("back").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  $("play").addEventListener("click", play);
  document.addEventListener("keydown", (event) => {
    const { tagName } = event.target;
    const action = { " ": play, ArrowLeft: () => step(-1), ArrowRight: () => step(1) }[event.key];
    // What has the focus may have a use for them itself.
    if (!drive || !action || ["SELECT", "INPUT"].includes(tagName) || (event.key === " " && tagName === "BUTTON")) return;
    event.preventDefault();
    action();
  });

  $("choose").hidden = !decodes;
  if (embedded) {
    show(async () => written(), "the drive");
  } else {
    invite();
  }
  if (!decodes) return;
  decoder = new Decoder();
  $("file").addEventListener("change", () => {
    const [file] = $("file").files;
    if (file) openFile(file);
    // So that the same file can be chosen again.
    $("file").value = "";
  });
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("over");
  });
  document.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) document.body.classList.remove("over");
  });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("over");
    const [file] = event.dataTransfer.files;
    if (file) openFile(file);
  });
  const url = new URLSearchParams(location.search).get("url");
  if (url) {
    const absolute = new URL(url, location.href).href;
    show(() => decoder.open(absolute), absolute);
  }
}

try {
  begin();
} catch (error) {
  fail(error);
}
