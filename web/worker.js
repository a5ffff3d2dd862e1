// Decodes on a thread of its own, for view.js. It is joined to js/index.js, and gets its calls in messages.

let wasm;
let drive;
/** Bytes of the files of the frames of a group, by the group's first frame. */
let sizes = new Map();

const calls = {
  /** The module, gzipped. */
  async begin(gzipped) {
    const inflated = new Blob([gzipped]).stream().pipeThrough(new DecompressionStream("gzip"));
    wasm = await WebAssembly.compile(await new Response(inflated).arrayBuffer());
  },

  async open(input) {
    const opened = await open(input, { wasm, rangeImages: true });
    drive?.close();
    drive = opened;
    sizes = new Map();
    const { name, length, byteLength, frames } = drive;
    return { name, length, byteLength, frames, scanners: await drive.scanners() };
  },

  async frame(number) {
    const group = drive.groupOf(number);
    if (!sizes.has(group.start)) {
      sizes.set(group.start, (await drive.details(group.start, group.end)).map(({ bytes }) => bytes));
    }
    const frame = await drive.frame(number);
    return { ...frame, bytes: sizes.get(group.start)[number - group.start], codedBytes: drive.frames[number].codedBytes };
  },
};

onmessage = async ({ data: { id, call, argument } }) => {
  try {
    const result = await calls[call](argument);
    const { positions, fields, rangeImage } = result ?? {};
    const arrays = [positions, ...Object.values(fields ?? {}), rangeImage?.ranges, rangeImage?.points];
    postMessage({ id, result }, arrays.filter(Boolean).map(({ buffer }) => buffer));
  } catch (error) {
    postMessage({ id, error: error?.message ?? String(error) });
  }
};
