// The page in a browser, opened from the disk. LIDARPC is the path of the program, CHROMIUM that of the browser.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { copyFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import test, { after, before } from "node:test";
import { fileURLToPath } from "node:url";

import { chromium } from "playwright-core";

const built = new URL("../lidarpc.html", import.meta.url);
const scans = fileURLToPath(new URL("../../testdata/drive/", import.meta.url));
const folder = mkdtempSync(join(tmpdir(), "lidarpc-page-"));
const drive = join(folder, "drive.lpc");
const damaged = join(folder, "damaged.lpc");
const written = join(folder, "drive.html");
const points = [0, 1, 2].map((number) => readFileSync(join(scans, `000000000${number}.bin`)).length / 16);
let browser;

before(async () => {
  const program = process.env.LIDARPC;
  assert.ok(program, "LIDARPC is to be the path of the program");
  execFileSync(program, ["encode", scans, "-o", drive, "--gop", "1", "--quiet"]);
  execFileSync(program, ["view", drive, "--html", written]);
  const bytes = readFileSync(drive);
  // In the second of three groups.
  bytes[bytes.length >> 1] ^= 1;
  writeFileSync(damaged, bytes);
  browser = await chromium.launchPersistentContext(join(folder, "profile"), {
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    viewport: { width: 1000, height: 700 },
    args: [
      ...["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run", "--disable-quic"],
      ...["--disable-background-networking", "--disable-component-update", "--disable-sync"],
    ],
  });
});

after(async () => {
  await browser?.close();
  rmSync(folder, { recursive: true, force: true });
});

/** A page that fails the test if a script of it fails, and what it asks for. */
async function opened(url) {
  const page = await browser.newPage();
  page.failures = [];
  page.requests = [];
  page.on("pageerror", (error) => page.failures.push(error.message));
  page.on("request", (request) => page.requests.push(request.url()));
  await page.goto(String(url));
  return page;
}

async function close(page) {
  assert.deepEqual(page.failures, []);
  await page.close();
}

const frameIs = (page, number) =>
  page.waitForFunction((number) => document.body.dataset.frame === number, String(number), { timeout: 30_000 });
const shownPoints = (page) => page.evaluate(() => Number(document.body.dataset.points));
const isError = (page) => page.locator("#error").isVisible();

/** The colours of an element's pixels, as it looks. */
async function pixels(page, id) {
  // Drawn with the next frame of the screen.
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  const png = (await page.locator(id).screenshot()).toString("base64");
  // As text, which is quicker than as a list of numbers.
  const url = await page.evaluate(async (png) => {
    const image = new Image();
    image.src = `data:image/png;base64,${png}`;
    await image.decode();
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    const reader = new FileReader();
    reader.readAsDataURL(new Blob([data]));
    await new Promise((resolve) => (reader.onload = resolve));
    return reader.result;
  }, png);
  const bytes = Uint8Array.from(Buffer.from(url.split(",")[1], "base64"));
  return new Uint32Array(bytes.buffer);
}

/** How many pixels are not of the commonest colour, which is the background. */
function drawn(pixels) {
  const counts = new Map();
  for (const pixel of pixels) counts.set(pixel, (counts.get(pixel) ?? 0) + 1);
  return pixels.length - Math.max(...counts.values());
}

function differing(one, other) {
  assert.equal(one.length, other.length);
  return one.filter((pixel, place) => pixel !== other[place]).length;
}

async function drop(page, path) {
  const transfer = await page.evaluateHandle(
    ([base64, name]) => {
      const bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
      const transfer = new DataTransfer();
      transfer.items.add(new File([bytes], name));
      return transfer;
    },
    [readFileSync(path).toString("base64"), "drive.lpc"],
  );
  await page.dispatchEvent("#space", "drop", { dataTransfer: transfer });
}

test("a dropped drive is drawn, frame after frame", async () => {
  const page = await opened(built);
  assert.match(await page.textContent("#hint"), /Drop a \.lpc file here/);
  await drop(page, drive);
  await frameIs(page, 0);
  assert.equal(await shownPoints(page), points[0]);
  assert.match(await page.textContent("#about"), /^drive\.lpc, 3 frames, 1\d\d kB, like Velodyne's HDL-64E, 64 lasers/);
  assert.match(await page.textContent("#frame"), /^1 \/ 3 · 0000000000\.bin · [\d,]+ points · 477 kB → \d\d\.\d kB, \d+\.\d %$/);

  const first = await pixels(page, "#points");
  assert.ok(drawn(first) > 5000, `${drawn(first)} pixels`);
  const image = await pixels(page, "#image");
  assert.ok(drawn(image) > image.length / 2);
  assert.equal(await page.evaluate(() => document.getElementById("image").height), 64);

  await page.click("#next");
  await frameIs(page, 1);
  assert.equal(await shownPoints(page), points[1]);
  const second = await pixels(page, "#points");
  assert.ok(differing(first, second) > 1000);
  await page.keyboard.press("ArrowLeft");
  await frameIs(page, 0);
  assert.equal(differing(first, await pixels(page, "#points")), 0);

  const colours = await page.locator("#colour option").allTextContents();
  assert.deepEqual(colours, ["height", "range", "ring", "intensity"]);
  for (const colour of colours.slice(1)) {
    await page.selectOption("#colour", colour);
    assert.ok(differing(first, await pixels(page, "#points")) > 3000, colour);
  }
  await page.selectOption("#colour", "height");

  await page.mouse.move(300, 300);
  await page.mouse.down();
  await page.mouse.move(420, 330);
  await page.mouse.up();
  const turned = await pixels(page, "#points");
  assert.ok(differing(first, turned) > 5000 && drawn(turned) > 5000);
  await page.mouse.wheel(0, -600);
  assert.ok(differing(turned, await pixels(page, "#points")) > 5000);
  await page.dblclick("#points");
  assert.equal(differing(first, await pixels(page, "#points")), 0);

  await page.fill("#place", "2");
  await frameIs(page, 2);
  await page.click("#play");
  await frameIs(page, 0);
  await frameIs(page, 2);
  await page.waitForFunction(() => document.getElementById("play").textContent === "Play");
  assert.ok(!(await isError(page)));
  // Nothing leaves the page.
  assert.deepEqual(page.requests.filter((url) => !/^(file|blob|data):/.test(url)), []);
  await close(page);
});

test("what is damaged is said, and the rest is shown", async () => {
  const page = await opened(built);
  await page.setInputFiles("#file", damaged);
  await frameIs(page, 0);
  assert.ok(!(await isError(page)));
  await page.click("#next");
  await page.waitForSelector("#error:visible");
  assert.match(await page.textContent("#error"), /^damaged\.lpc: frame 1: damaged stream: /);
  await page.click("#next");
  await frameIs(page, 2);
  assert.ok(!(await isError(page)));

  const noStream = join(folder, "scan.lpc");
  copyFileSync(join(scans, "0000000000.bin"), noStream);
  await page.setInputFiles("#file", noStream);
  await page.waitForSelector("#error:visible");
  assert.match(await page.textContent("#error"), /^scan\.lpc: not a lidarpc stream/);
  // The drive before is still there.
  await page.click("#back");
  await page.waitForSelector("#error:visible");
  await page.click("#back");
  await frameIs(page, 0);
  await close(page);
});

test("a drive of a server is read piece by piece", async () => {
  const bytes = readFileSync(drive);
  const asked = [];
  const server = createServer((request, response) => {
    const allowed = { "Access-Control-Allow-Origin": "*", "Access-Control-Allow-Headers": "Range" };
    if (request.method === "OPTIONS") return response.writeHead(204, allowed).end();
    const [, start, end] = /^bytes=(\d*)-(\d*)$/.exec(request.headers.range);
    const [from, to] = start === "" ? [bytes.length - end, bytes.length] : [Number(start), Number(end) + 1];
    asked.push([from, to]);
    const headers = { ...allowed, "Access-Control-Expose-Headers": "Content-Range" };
    headers["Content-Range"] = `bytes ${from}-${to - 1}/${bytes.length}`;
    response.writeHead(206, headers).end(bytes.subarray(from, to));
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const url = `http://127.0.0.1:${server.address().port}/drive.lpc`;
  const page = await opened(`${built}?url=${encodeURIComponent(url)}`);
  await frameIs(page, 0);
  assert.equal(await shownPoints(page), points[0]);
  assert.ok(asked.length >= 2 && asked.every(([from, to]) => to - from <= 65536), JSON.stringify(asked));
  await close(page);
  await new Promise((resolve) => server.close(resolve).closeAllConnections());
});

test("the program's page shows what the decoder shows", async () => {
  const [page, other] = [await opened(`file://${written}`), await opened(built)];
  await frameIs(page, 0);
  assert.ok(!(await page.locator("#choose").isVisible()), "it has no decoder to open files with");
  await other.setInputFiles("#file", drive);
  for (const number of [0, 1, 2]) {
    for (const each of [page, other]) {
      await each.fill("#place", String(number));
      await frameIs(each, number);
    }
    assert.equal(await shownPoints(page), points[number]);
    assert.equal(await page.textContent("#frame"), await other.textContent("#frame"));
    for (const id of ["#points", "#image"]) {
      const [one, decoded] = [await pixels(page, id), await pixels(other, id)];
      assert.ok(drawn(one) > 5000);
      // Centimetres move few points to another pixel, and change colours little.
      const apart = (a, b) => [0, 8, 16].some((shift) => Math.abs(((a >> shift) & 255) - ((b >> shift) & 255)) > 24);
      const far = one.filter((pixel, place) => apart(pixel, decoded[place])).length;
      assert.ok(far < drawn(one) / 10, `${id} of frame ${number}: ${far} of ${drawn(one)} pixels`);
    }
  }
  assert.equal(await page.textContent("#about"), await other.textContent("#about"));
  const colours = (each) => each.locator("#colour option").allTextContents();
  assert.deepEqual(await colours(page), await colours(other));
  assert.deepEqual(page.requests.filter((url) => !/^(file|blob|data):/.test(url)), []);
  await close(page);
  await close(other);
});
