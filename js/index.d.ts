/** An array of values of a field: of the type that the file has them in. */
export type TypedArray =
  | Int8Array
  | Uint8Array
  | Int16Array
  | Uint16Array
  | Int32Array
  | Uint32Array
  | BigInt64Array
  | BigUint64Array
  | Float32Array
  | Float64Array;

/** Anything that bytes can be read from by their place. */
export interface Source {
  /** Bytes in all. */
  readonly size: number;
  /** The bytes from `start` up to, not including, `end`, which is at most `size`. */
  read(start: number, end: number): Promise<ArrayBuffer | ArrayBufferView> | ArrayBuffer | ArrayBufferView;
  /** What errors call it. */
  readonly name?: string;
}

export interface OpenOptions {
  /** Whether frames come with their range images. Default: no; they take some time and memory. */
  rangeImages?: boolean;
  /**
   * The module `lidarpc.wasm`: compiled, as bytes, or where it is. Default: beside `index.js`. Compiled once and handed over,
   * it serves many drives, and workers, too.
   */
  wasm?: WebAssembly.Module | ArrayBuffer | ArrayBufferView | URL | string;
  /** Of a URL: what fetches it instead of the global `fetch`. */
  fetch?: typeof fetch;
  /** Of a URL: headers of each request, such as `Authorization`. */
  headers?: Record<string, string>;
  /** Of a URL: ends requests, those of later calls, too. */
  signal?: AbortSignal;
}

/**
 * Opens a stream, and reads its index: of a file that is at hand, or of a server by range requests. A server of another origin
 * should expose the header `Content-Range`; one that knows no ranges is read as a whole.
 *
 * @throws {LidarpcError} if it cannot be read, is no stream, is damaged at its end, or is of another version of the format.
 */
export function open(
  source: Blob | ArrayBuffer | ArrayBufferView | URL | string | Source,
  options?: OpenOptions,
): Promise<Drive>;

/** A sequence of frames. One call is worked on at a time; those that are made meanwhile wait. */
export interface Drive extends AsyncIterable<Frame> {
  /** What errors call it: the name of the file, the URL, or nothing. */
  readonly name: string;
  /** Bytes of the stream. */
  readonly byteLength: number;
  /** Number of frames. Files that were kept beside the scans are not counted. */
  readonly length: number;
  /** What the index says of each frame. */
  readonly frames: readonly FrameInfo[];

  /**
   * Decodes a frame, the first being 0. Its group is read, if it is not that of the frame before, and decoded as far as this
   * frame; so frames in order cost least.
   *
   * @param options.file whether it comes with the bytes of the file that it was. Default: no.
   * @throws {LidarpcError} if there is no such frame, or it cannot be read, or is damaged.
   */
  frame(number: number, options?: { file?: boolean }): Promise<Frame>;

  /** The frames that are coded together with this one: from `start` up to, not including, `end`. */
  groupOf(number: number): { start: number; end: number };

  /**
   * Names and sizes of the frames from `start` up to, not including, `end`; all, if left out. Reads their groups, but decodes
   * nothing.
   */
  details(start?: number, end?: number): Promise<FrameDetails[]>;

  /** What was found of each scanner, in a sentence. Reads nothing of the frames. */
  scanners(): Promise<string[]>;

  /** Lets go of the memory. Calls fail from now on. */
  close(): void;
}

/** What the index says of a frame. */
export interface FrameInfo {
  /** The first being 0. */
  readonly number: number;
  /** What it was. */
  readonly kind: "file" | "message" | "points";
  /** Which of several scanners that take turns it is of; the first is 0. */
  readonly track: number;
  /** When it was taken: nanoseconds since 1970. */
  readonly time: bigint | null;
  /** Bytes that it takes in the stream. */
  readonly codedBytes: number;
}

/** What a stream says of a frame, short of decoding it. */
export interface FrameDetails {
  readonly number: number;
  /** Empty if it has none. It may be any: check it before use as a path. */
  readonly name: string;
  readonly points: number;
  /** Bytes of its file, or of the points as records. */
  readonly bytes: number;
}

/** A decoded scan. Its arrays are the caller's own. */
export interface Frame {
  readonly number: number;
  /** Empty if it has none. It may be any: check it before use as a path. */
  readonly name: string;
  readonly kind: "file" | "message" | "points";
  readonly track: number;
  /** When it was taken: nanoseconds since 1970. */
  readonly time: bigint | null;
  /** Number of points. */
  readonly length: number;
  /**
   * x, y and z of each point, one point after the other, in metres: three times `length` values, in the order of the file.
   * Where the file has them in another type than float32, they are rounded, and the file's own are in `fields`. Empty if the
   * file has no positions.
   */
  readonly positions: Float32Array;
  /** The other fields by their names, point after point. An object without a prototype. */
  readonly fields: Record<string, TypedArray>;
  /** How many values of a field a point has: 1 but for fields of files that have more. */
  readonly counts: Record<string, number>;
  /** If it was asked for by `rangeImages` and the scanner is known. */
  readonly rangeImage: RangeImage | null;
  /** The bytes of the file that it was, if they were asked for and it was one. */
  readonly file: Uint8Array | null;
}

/** The points of a scan in rows and columns: a row for each laser, a column for each azimuth at which the lasers fired. */
export interface RangeImage {
  readonly rows: number;
  readonly columns: number;
  /** How far the first return of each cell is from the laser, in metres, row after row; 0 where there is none. */
  readonly ranges: Float32Array;
  /** Which point of the frame each cell is, row after row; -1 where there is none. */
  readonly points: Int32Array;
}

/** What went wrong, in one line that names the file and the frame. */
export class LidarpcError extends Error {
  constructor(message: string, about?: { file?: string; frame?: number | null; cause?: unknown });
  /** The name of the file, or the URL; may be empty. */
  readonly file: string;
  /** The number of the frame that it is about, if it is about one. */
  readonly frame: number | null;
}
