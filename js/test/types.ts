// Compiled, not run: how a program in TypeScript uses the package.

import { LidarpcError, open, type Drive, type Frame, type RangeImage, type Source } from "lidarpc";

export async function all(file: File, bytes: Uint8Array, source: Source, module: WebAssembly.Module): Promise<number> {
  const drives: Drive[] = [
    await open(file, { rangeImages: true, wasm: module }),
    await open(bytes),
    await open(source),
    await open(new URL("https://example.org/drive.lpc"), { headers: { Authorization: "" }, signal: AbortSignal.timeout(1) }),
  ];
  let points = 0;
  for (const drive of drives) {
    const time: bigint | null = drive.frames[0].time;
    const frame: Frame = await drive.frame(0, { file: true });
    const file: Uint8Array | null = frame.file;
    const image: RangeImage | null = frame.rangeImage;
    // @ts-expect-error An array of a field may be of big integers.
    const values: Float32Array = frame.fields.intensity;
    for await (const { positions } of drive) points += positions.length / 3;
    const names: string[] = (await drive.details()).map(({ name }) => name);
    console.log(time, file, image, values, names, await drive.scanners(), drive.groupOf(0).end);
    drive.close();
  }
  return points;
}

export function frameOf(error: unknown): number | null {
  return error instanceof LidarpcError ? error.frame : null;
}

// @ts-expect-error A number is no stream.
void open(17);
