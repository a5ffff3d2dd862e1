// Every golden stream decodes to the bytes that the list beside it tells of, as in the program.

import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import test from "node:test";

import { LidarpcError, open } from "lidarpc";

const folder = new URL("../../testdata/golden/", import.meta.url);

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  for (let bit = 0; bit < 8; bit++) byte = byte & 1 ? (byte >>> 1) ^ 0x82f63b78 : byte >>> 1;
  return byte;
});

function crc32c(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) crc = (crc >>> 8) ^ TABLE[(crc ^ byte) & 0xff];
  return ((crc ^ 0xffffffff) >>> 0).toString(16).padStart(8, "0");
}

const names = readdirSync(folder).filter((name) => name.endsWith(".lpc"));
assert.ok(names.length > 40);

for (const name of names) {
  test(name, async () => {
    const drive = await open(readFileSync(new URL(name, folder)), { rangeImages: true });
    const listed = readFileSync(new URL(name.replace(/lpc$/, "txt"), folder), "utf8").trimEnd().split("\n");
    const decoded = [];
    try {
      for (let number = 0; number < drive.length; number++) {
        const { name, file, length, positions } = await drive.frame(number, { file: true });
        decoded.push(`${name} ${file.length} ${crc32c(file)}`);
        assert.ok(positions.length === 0 || positions.length === 3 * length);
      }
    } catch (error) {
      // Image coders are left out, for size.
      assert.ok(error instanceof LidarpcError);
      assert.match(error.message, /ranges coded by jpeg.*built without the feature `article`/);
      return assert.match(name, /jpeg/);
    }
    // A tree's files beside the scans stand in its list, too.
    const scans = name === "tree.lpc" ? drive.length : listed.length;
    assert.deepEqual(decoded, listed.slice(0, scans));
  });
}
