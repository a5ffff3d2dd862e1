// Measures how fast a whole drive is decoded on one thread: node js/speed.js drive.lpc. Compare with
// `time lidarpc verify --threads 1 drive.lpc`, which decodes the same.

import { openAsBlob } from "node:fs";
import { open } from "lidarpc";

const begun = performance.now();
const drive = await open(await openAsBlob(process.argv[2]));
const before = process.cpuUsage();
const started = performance.now();
let points = 0;
let first;
for await (const frame of drive) {
  points += frame.length;
  first ??= performance.now() - begun;
}
const seconds = (performance.now() - started) / 1000;
const { user, system } = process.cpuUsage(before);
const per = (time) => (drive.length / time).toFixed(1);
console.log(
  `${drive.length} frames of ${Math.round(points / drive.length)} points: ${per(seconds)} frames a second,`,
  `${per((user + system) / 1e6)} a second of the processor; the first after ${first.toFixed(0)} ms`,
);
