// Decodes lidarpc streams. The public interface is documented in index.d.ts. The decoder itself is src/wasm.rs of the
// crate.

/** The results of the module's calls: there is an answer, or bytes are missing. */
const DONE = 0;
const WANTS = 1;

/** The type of array for each type of field. */
const ARRAYS = {
  i8: Int8Array,
  u8: Uint8Array,
  i16: Int16Array,
  u16: Uint16Array,
  i32: Int32Array,
  u32: Uint32Array,
  i64: BigInt64Array,
  u64: BigUint64Array,
  f32: Float32Array,
  f64: Float64Array,
};

/** The fields of positions. */
const POSITION = ["x", "y", "z"];

export class LidarpcError extends Error {
  constructor(message, { file = "", frame = null, cause } = {}) {
    super(file ? `${file}: ${message}` : message, cause === undefined ? undefined : { cause });
    this.name = "LidarpcError";
    this.file = file;
    this.frame = frame;
  }
}

/** A promise of the module beside this file, which is compiled when it is first needed. */
let compiled;

/** The compiled module; compiles it if necessary. */
async function moduleOf(wasm) {
  if (wasm instanceof WebAssembly.Module) return wasm;
  if (wasm !== undefined) return WebAssembly.compile(await bytesOf(wasm));
  compiled ??= bytesOf(new URL("lidarpc.wasm", import.meta.url)).then((bytes) => WebAssembly.compile(bytes));
  try {
    return await compiled;
  } catch (error) {
    compiled = undefined;
    throw error;
  }
}

/** The bytes of the module. */
async function bytesOf(wasm) {
  if (!(wasm instanceof URL || typeof wasm === "string")) return wasm;
  const url = new URL(wasm, import.meta.url);
  // `fetch` of Node.js does not read files, and an import of node:fs breaks bundles for browsers.
  const files = url.protocol === "file:" ? globalThis.process?.getBuiltinModule?.("node:fs") : undefined;
  if (files) return files.promises.readFile(url);
  const response = await fetch(url);
  if (!response.ok) throw new LidarpcError(`HTTP status ${response.status}`, { file: url.href });
  return response.arrayBuffer();
}

/**
 * The source that `open` reads from: its name, its size, and a function that returns the bytes from `start` to `end`,
 * exclusive.
 */
async function sourceOf(input, options) {
  if (input instanceof ArrayBuffer || ArrayBuffer.isView(input)) {
    const bytes = input instanceof ArrayBuffer ? new Uint8Array(input) : view(input);
    return { name: "", size: bytes.length, read: async (start, end) => bytes.subarray(start, end) };
  }
  if (typeof Blob !== "undefined" && input instanceof Blob) {
    const read = async (start, end) => new Uint8Array(await input.slice(start, end).arrayBuffer());
    return { name: input.name ?? "", size: input.size, read };
  }
  if (typeof input === "string" || input instanceof URL) return remote(String(input), options);
  if (typeof input?.size === "number" && typeof input?.read === "function") {
    const read = async (start, end) => view(await input.read(start, end));
    return { name: input.name ?? "", size: input.size, read };
  }
  throw new TypeError("open takes a Blob, an ArrayBuffer, a Uint8Array, a URL, or an object with size and read");
}

function view(bytes) {
  return bytes instanceof ArrayBuffer
    ? new Uint8Array(bytes)
    : new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** Number of bytes at the end of a stream that the decoder reads first. */
const TAIL = 1 << 16;

/** A file on a server, read by range requests, or as a whole if the server does not support them. */
async function remote(url, { fetch: fetchIt = globalThis.fetch, signal, headers } = {}) {
  const request = async (range) => {
    let response;
    try {
      response = await fetchIt(url, { signal, headers: { ...headers, Range: `bytes=${range}` } });
    } catch (error) {
      if (error?.name === "AbortError") throw error;
      throw new LidarpcError(`cannot be fetched: ${error?.message ?? error}`, { file: url, cause: error });
    }
    if (!response.ok) throw new LidarpcError(`HTTP status ${response.status}`, { file: url });
    return response;
  };
  const whole = (bytes) => ({ name: url, size: bytes.length, read: async (start, end) => bytes.subarray(start, end) });

  // One request returns the size and the end.
  const first = await request(`-${TAIL}`);
  const tail = new Uint8Array(await first.arrayBuffer());
  if (first.status !== 206) return whole(tail);
  // A server of another origin may hide Content-Range. If fewer bytes came than requested, they are the whole file.
  const total = /\/(\d+)$/.exec(first.headers.get("Content-Range") ?? "")?.[1];
  let size = Number(total);
  if (total === undefined) {
    if (tail.length < TAIL) return whole(tail);
    const head = await fetchIt(url, { method: "HEAD", signal, headers });
    size = Number(head.headers.get("Content-Length") ?? NaN);
    if (!head.ok || !(size >= tail.length)) {
      const message = "the server does not tell its size: it should expose the header Content-Range";
      throw new LidarpcError(message, { file: url });
    }
  }
  const read = async (start, end) => {
    if (start >= size - tail.length) return tail.subarray(start - size + tail.length, end - size + tail.length);
    const response = await request(`${start}-${end - 1}`);
    const bytes = new Uint8Array(await response.arrayBuffer());
    return response.status === 206 ? bytes : bytes.subarray(start, end);
  };
  return { name: url, size, read };
}

export async function open(input, options = {}) {
  const [module, source] = await Promise.all([moduleOf(options.wasm), sourceOf(input, options)]);
  const instance = await WebAssembly.instantiate(module, {});
  const decoder = new Decoder(instance.exports, source);
  const { answer } = await decoder.call((wasm) => wasm.lidarpc_open(source.size, options.rangeImages ? 1 : 0));
  return new Drive(decoder, source, answer);
}

/** An instance of the module, with the source that it reads. */
class Decoder {
  #wasm;
  #source;
  /** Resolves when the last call has ended. */
  #last = Promise.resolve();

  constructor(wasm, source) {
    this.#wasm = wasm;
    this.#source = source;
  }

  close() {
    this.#wasm = null;
  }

  fail(message, frame = null, cause = undefined) {
    return new LidarpcError(message, { file: this.#source.name, frame, cause });
  }

  /**
   * Calls the module, supplies the bytes that it asks for, and returns its answer, converted by `take`, which may copy
   * arrays. Calls run one after the other.
   */
  call(make, take = (answer) => ({ answer })) {
    const result = this.#last.then(() => this.#call(make, take));
    this.#last = result.catch(() => {});
    return result;
  }

  async #call(make, take) {
    for (;;) {
      const wasm = this.#wasm;
      if (!wasm) throw this.fail("the drive is closed");
      const status = this.#run(() => make(wasm));
      if (status === WANTS) {
        await this.#supply(wasm, wasm.lidarpc_wanted_start(), wasm.lidarpc_wanted_end());
        continue;
      }
      const bytes = new Uint8Array(wasm.memory.buffer, wasm.lidarpc_answer(), wasm.lidarpc_answer_bytes());
      const answer = JSON.parse(new TextDecoder().decode(bytes));
      if (status !== DONE) throw this.fail(answer.message, answer.frame);
      return take(answer, ({ address, bytes }) => wasm.memory.buffer.slice(address, address + bytes));
    }
  }

  /** Runs the module. After a trap (memory is exhausted, or there is a bug), the instance cannot be used any more. */
  #run(work) {
    try {
      return work();
    } catch (cause) {
      this.close();
      throw this.fail(`the decoder stopped (${cause.message}): out of memory, or a fault of lidarpc`, null, cause);
    }
  }

  async #supply(wasm, start, end) {
    let bytes;
    try {
      bytes = await this.#source.read(start, end);
    } catch (cause) {
      if (cause instanceof LidarpcError || cause?.name === "AbortError") throw cause;
      throw this.fail(`cannot be read: ${cause?.message ?? cause}`, null, cause);
    }
    if (bytes.length !== end - start) {
      throw this.fail(`bytes ${start} to ${end} were asked for, and ${bytes.length} came: has the file changed?`);
    }
    const room = this.#run(() => wasm.lidarpc_room(bytes.length));
    new Uint8Array(wasm.memory.buffer, room, bytes.length).set(bytes);
    wasm.lidarpc_supply(start);
  }
}

class Drive {
  #decoder;
  #groups;

  constructor(decoder, source, { frames, groups }) {
    this.#decoder = decoder;
    this.#groups = groups;
    this.name = source.name;
    this.byteLength = source.size;
    this.length = frames.length;
    this.frames = frames.map((frame) => ({ ...frame, time: timeOf(frame.time) }));
  }

  groupOf(number) {
    this.#check(number);
    const next = this.#groups.findIndex((first) => first > number);
    return { start: this.#groups[next - 1], end: this.#groups[next] };
  }

  async details(start = 0, end = this.length) {
    const { answer } = await this.#decoder.call((wasm) => wasm.lidarpc_details(start, end));
    return answer;
  }

  async scanners() {
    const { answer } = await this.#decoder.call((wasm) => wasm.lidarpc_scanners());
    return answer;
  }

  async frame(number, { file = false } = {}) {
    this.#check(number);
    return this.#decoder.call((wasm) => wasm.lidarpc_frame(number, file ? 1 : 0), frameOf);
  }

  async *[Symbol.asyncIterator]() {
    for (let number = 0; number < this.length; number++) yield await this.frame(number);
  }

  close() {
    this.#decoder.close();
  }

  #check(number) {
    if (!Number.isInteger(number) || number < 0 || number >= this.length) {
      throw this.#decoder.fail(`there is no frame ${number}; the stream has ${this.length} frames`);
    }
  }
}

function timeOf(time) {
  return time === null ? null : BigInt(time);
}

/** A frame from the module's answer, with copies of its arrays. */
function frameOf({ number, name, kind, track, time, points, positions, fields, image, file }, copy) {
  const named = Object.create(null);
  const counts = Object.create(null);
  for (const field of fields) {
    named[field.name] = new ARRAYS[field.scalar](copy(field.values));
    counts[field.name] = field.count;
  }
  return {
    number,
    name,
    kind,
    track,
    time: timeOf(time),
    length: points,
    positions: positions.bytes > 0 ? new Float32Array(copy(positions)) : positionsOf(named, points),
    fields: named,
    counts,
    rangeImage: image && {
      rows: image.rows,
      columns: image.columns,
      ranges: new Float32Array(copy(image.ranges)),
      points: new Int32Array(copy(image.points)),
    },
    file: file && new Uint8Array(copy(file)),
  };
}

/** Positions of a file whose coordinates have another type than float32. */
function positionsOf(fields, points) {
  if (!POSITION.every((name) => fields[name]?.length === points)) return new Float32Array(0);
  const positions = new Float32Array(3 * points);
  POSITION.forEach((name, axis) => {
    const values = fields[name];
    for (let point = 0; point < points; point++) positions[3 * point + axis] = Number(values[point]);
  });
  return positions;
}
