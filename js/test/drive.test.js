// What a drive gives, and what it reads for it. The drive is testdata/drive three times, each frame a group of its own, made by
// the program, whose path is in LIDARPC.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, openAsBlob, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import test, { after, before } from "node:test";
import { fileURLToPath } from "node:url";
import { Worker } from "node:worker_threads";

import { LidarpcError, open } from "lidarpc";

const scans = fileURLToPath(new URL("../../testdata/drive/", import.meta.url));
const original = (number) => readFileSync(join(scans, `000000000${number % 3}.bin`));
const LAST = 8;

const folder = mkdtempSync(join(tmpdir(), "lidarpc-"));
const path = join(folder, "drive.lpc");
let bytes;

before(() => {
  const program = process.env.LIDARPC;
  assert.ok(program, "LIDARPC is to be the path of the program");
  for (let number = 0; number <= LAST; number++) writeFileSync(join(folder, `000000000${number}.bin`), original(number));
  execFileSync(program, ["encode", folder, "-o", path, "--gop", "1", "--quiet"]);
  bytes = readFileSync(path);
});

after(() => rmSync(folder, { recursive: true }));

/** A server of the drive, that keeps what it was asked for. */
async function serve(answer) {
  const requests = [];
  const server = createServer((request, response) => {
    requests.push(request.headers.range ?? request.method);
    answer(request, response);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const close = () => new Promise((resolve) => server.close(resolve).closeAllConnections());
  return { url: `http://127.0.0.1:${server.address().port}/drive.lpc`, requests, close };
}

function ranged(request, response, exposes = true) {
  const [, start, end] = /^bytes=(\d*)-(\d*)$/.exec(request.headers.range ?? "") ?? [];
  if (request.method === "HEAD") return response.writeHead(200, { "Content-Length": bytes.length }).end();
  const from = start === "" ? bytes.length - Number(end) : Number(start);
  const to = start === "" ? bytes.length : Number(end) + 1;
  const headers = exposes ? { "Content-Range": `bytes ${from}-${to - 1}/${bytes.length}` } : {};
  response.writeHead(206, headers).end(bytes.subarray(from, to));
}

async function isWhole(drive) {
  assert.equal(drive.length, LAST + 1);
  for (const number of [0, LAST, 4]) {
    const frame = await drive.frame(number, { file: true });
    assert.deepEqual(Buffer.from(frame.file), original(number));
  }
}

test("from memory, a blob, an object", async () => {
  await isWhole(await open(bytes));
  await isWhole(await open(Uint8Array.from(bytes).buffer));
  const padded = new Uint8Array(bytes.length + 7);
  padded.set(bytes, 3);
  await isWhole(await open(padded.subarray(3, 3 + bytes.length)));
  await isWhole(await open(new DataView(padded.buffer, 3, bytes.length)));
  await isWhole(await open(await openAsBlob(path)));
  await isWhole(await open({ size: bytes.length, read: (start, end) => bytes.subarray(start, end) }));
  await assert.rejects(open(17), TypeError);
});

test("a frame's arrays are those of its file", async () => {
  const drive = await open(bytes, { rangeImages: true });
  const { number, name, kind, track, time, length, positions, fields, counts, rangeImage, file } = await drive.frame(1);
  assert.deepEqual({ number, name, kind, track, time, file }, {
    number: 1, name: "0000000001.bin", kind: "file", track: 0, time: null, file: null,
  });
  const values = new Float32Array(Uint8Array.from(original(1)).buffer);
  assert.equal(length, values.length / 4);
  assert.ok(positions instanceof Float32Array && fields.intensity instanceof Float32Array);
  const joined = new Float32Array(values.length);
  for (let point = 0; point < length; point++) {
    joined.set(positions.subarray(3 * point, 3 * point + 3), 4 * point);
    joined[4 * point + 3] = fields.intensity[point];
  }
  assert.deepEqual(new Uint8Array(joined.buffer), new Uint8Array(values.buffer));
  assert.deepEqual([Object.keys(fields), { ...counts }], [["intensity"], { intensity: 1 }]);

  const { rows, columns, ranges, points } = rangeImage;
  assert.equal(rows, 64);
  assert.deepEqual([ranges.length, points.length], [rows * columns, rows * columns]);
  const seen = points.filter((point) => point >= 0);
  assert.ok(new Set(seen).size === seen.length && seen.length > 0.9 * length);
  points.forEach((point, cell) => {
    const range = point < 0 ? 0 : Math.hypot(...positions.subarray(3 * point, 3 * point + 3));
    // The lasers are not where the coordinates begin.
    assert.ok(Math.abs(ranges[cell] - range) < 0.5, `${cell}: ${ranges[cell]} ${range}`);
  });
  assert.equal((await (await open(bytes)).frame(1)).rangeImage, null);
});

test("what the stream says of frames and scanners", async () => {
  const drive = await open(await openAsBlob(path));
  assert.equal(drive.byteLength, bytes.length);
  assert.deepEqual(drive.groupOf(4), { start: 4, end: 5 });
  const { number, codedBytes, ...rest } = drive.frames[4];
  assert.deepEqual({ number, ...rest }, { number: 4, kind: "file", track: 0, time: null });
  assert.ok(codedBytes > 1000 && codedBytes < bytes.length / 4);
  const details = await drive.details(3, 5);
  assert.deepEqual(details.map(({ number, name, bytes }) => [number, name, bytes]), [
    [3, "0000000003.bin", original(0).length],
    [4, "0000000004.bin", original(4).length],
  ]);
  assert.equal((await drive.details()).length, LAST + 1);
  assert.match((await drive.scanners())[0], /HDL-64E, 64 lasers/);
  let frames = 0;
  for await (const frame of drive) assert.equal(frame.number, frames++);
  assert.equal(frames, LAST + 1);
});

test("of a server, only the end and the group are read", async () => {
  const server = await serve(ranged);
  const drive = await open(server.url);
  assert.deepEqual(server.requests, ["bytes=-65536"]);
  const { file } = await drive.frame(1, { file: true });
  assert.deepEqual(Buffer.from(file), original(1));
  assert.equal(server.requests.length, 2);
  const [, start, end] = /bytes=(\d+)-(\d+)/.exec(server.requests[1]);
  const read = Number(end) - Number(start) + 1;
  const coded = drive.frames[1].codedBytes;
  assert.ok(read >= coded && read < coded + 100, `${read} bytes for ${coded}`);
  await drive.frame(1);
  assert.equal(server.requests.length, 2);
  await server.close();
  await assert.rejects(drive.frame(3), /drive\.lpc: cannot be fetched/);
});

test("servers that say less", async () => {
  const silent = await serve((request, response) => ranged(request, response, false));
  await isWhole(await open(silent.url));
  assert.equal(silent.requests[1], "HEAD");
  await silent.close();

  const whole = await serve((_, response) => response.end(bytes));
  await isWhole(await open(new URL(whole.url)));
  assert.equal(whole.requests.length, 1);
  await whole.close();

  const none = await serve((_, response) => response.writeHead(404).end());
  await assert.rejects(open(none.url), { name: "LidarpcError", file: none.url, message: /HTTP status 404/ });
  await none.close();

  const asked = [];
  const fetchIt = (url, { headers }) => (asked.push(headers), Promise.resolve(new Response(bytes)));
  await isWhole(await open("https://example.org/a.lpc", { fetch: fetchIt, headers: { Authorization: "x" } }));
  assert.deepEqual(asked, [{ Authorization: "x", Range: "bytes=-65536" }]);
});

test("calls wait for one another", async () => {
  const drive = await open(await openAsBlob(path));
  const numbers = [7, 0, 3, 3, 8, 1];
  const frames = await Promise.all(numbers.map((number) => drive.frame(number, { file: true })));
  assert.deepEqual(frames.map((frame) => frame.number), numbers);
  frames.forEach((frame) => assert.deepEqual(Buffer.from(frame.file), original(frame.number)));
});

test("errors name file and frame, and the rest still decodes", async () => {
  const drive = await open(await openAsBlob(path));
  for (const number of [-1, LAST + 1, 0.5, "0"]) {
    await assert.rejects(drive.frame(number), { name: "LidarpcError", message: `there is no frame ${number}; the stream has 9 frames` });
  }

  const damaged = Uint8Array.from(bytes);
  damaged[Math.round(bytes.length * 0.4)] ^= 1;
  const file = Object.assign(new Blob([damaged]), { name: "damaged.lpc" });
  const half = await open(file);
  const errors = [];
  for (let number = 0; number <= LAST; number++) await half.frame(number).catch((error) => errors.push(error));
  assert.equal(errors.length, 1);
  const [error] = errors;
  assert.ok(error instanceof LidarpcError);
  assert.equal(error.file, "damaged.lpc");
  assert.ok(error.frame > 0 && error.frame < LAST);
  assert.match(error.message, new RegExp(`^damaged\\.lpc: frame ${error.frame}: damaged stream: [^\\n]+$`));

  await assert.rejects(open(bytes.subarray(0, 1000)), /damaged stream/);
  await assert.rejects(open(new Uint8Array(0)), LidarpcError);
  await assert.rejects(open(original(0)), /not a lidarpc stream/);
  await assert.rejects(open({ size: bytes.length, read: () => new Uint8Array(3) }), /has the file changed/);
  const failing = { size: bytes.length, read: () => Promise.reject(new Error("no such disk")) };
  await assert.rejects(open(failing), { message: "cannot be read: no such disk" });

  drive.close();
  await assert.rejects(drive.frame(0), /closed/);
});

test("in a worker, with a module compiled elsewhere", async () => {
  const module = await WebAssembly.compile(readFileSync(new URL("../lidarpc.wasm", import.meta.url)));
  const source = `
    import { parentPort, workerData } from "node:worker_threads";
    import { open } from ${JSON.stringify(import.meta.resolve("lidarpc"))};
    const drive = await open(workerData.blob, { wasm: workerData.module });
    const { positions } = await drive.frame(2);
    parentPort.postMessage(positions, [positions.buffer]);`;
  const worker = new Worker(new URL(`data:text/javascript,${encodeURIComponent(source)}`), {
    workerData: { module, blob: new Blob([bytes]) },
  });
  const positions = await new Promise((resolve, reject) => worker.on("message", resolve).on("error", reject));
  assert.deepEqual(positions, (await (await open(bytes)).frame(2)).positions);
});
