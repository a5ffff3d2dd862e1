// Builds web/lidarpc.html: the page with its decoder, all in one file, for a page that is opened from a disk can load no other.
// js/build comes first.

import { readFileSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const read = (path) => readFileSync(new URL(path, import.meta.url));
const text = (path) => read(path).toString("utf8");

function inline(attributes, contents) {
  if (/<\/script|<!--/i.test(contents)) throw new Error(`what goes into <script ${attributes}> would end it`);
  return `<script ${attributes}>${contents}</script>`;
}

/** The page with a part put in place of what stands for it. */
function filled(page, mark, part) {
  if (page.split(mark).length !== 2) throw new Error(`page.html should have one ${mark}`);
  return page.replace(mark, () => part);
}

const module = gzipSync(read("../js/lidarpc.wasm"), { level: 9 }).toString("base64");
// Browsers take no module as the worker of a page that was opened from a disk.
const index = text("../js/index.js").replace(/^export /gm, "").replaceAll("import.meta.url", "location.href");
const worker = `${index}\n${text("worker.js")}`;
const decoder = inline('type="text/plain" id="module"', module) + inline('type="text/plain" id="worker"', worker);
let page = filled(text("page.html"), "<!-- contents -->", decoder);
page = filled(page, '<script type="module" src="view.js"></script>', inline('type="module"', text("view.js")));
writeFileSync(new URL("lidarpc.html", import.meta.url), page);
console.log(`web/lidarpc.html: ${page.length} bytes`);
