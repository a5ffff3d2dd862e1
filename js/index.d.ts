/** The values of a field, in an array of the type that the field has in the file. */
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

/** An input of your own: any object from which bytes can be read at a given offset. */
export interface Source {
  /** Size of the stream in bytes. */
  readonly size: number;
  /**
   * Returns the bytes from offset `start` to offset `end`, exclusive. `end` is at most `size`. If the result has
   * another length, the call that needs the bytes fails.
   */
  read(start: number, end: number): Promise<ArrayBuffer | ArrayBufferView> | ArrayBuffer | ArrayBufferView;
  /** A name for error messages. Default: empty. */
  readonly name?: string;
}

export interface OpenOptions {
  /** Whether frames contain their range images. Default: false, because range images take time and memory. */
  rangeImages?: boolean;
  /**
   * The WebAssembly module `lidarpc.wasm`: a compiled module, its bytes, or its URL (a relative URL is resolved against
   * `index.js`). Default: the file beside `index.js`, which is compiled once for all drives. A compiled module can be
   * shared by several drives, and sent to workers.
   */
  wasm?: WebAssembly.Module | ArrayBuffer | ArrayBufferView | URL | string;
  /** For URLs: the function that makes the requests. Default: the global `fetch`. */
  fetch?: typeof fetch;
  /** For URLs: headers that are added to every request, such as `Authorization`. */
  headers?: Record<string, string>;
  /**
   * For URLs: aborts the requests of `open`, and those of all later calls of the drive. After `abort()`, calls that
   * need a request are rejected with an `AbortError`.
   */
  signal?: AbortSignal;
}

/**
 * Opens a stream and reads its index, which is at the end of the stream. From a server, only the index is fetched now,
 * and the groups of frames when they are needed, by range requests. A server without range requests sends the whole
 * file at once. A server of another origin should expose the header `Content-Range`.
 *
 * @throws {LidarpcError} if the input cannot be read, is not a lidarpc stream, has another version of the format, or if
 * its end is damaged.
 * @throws {TypeError} if `source` has none of the types below.
 */
export function open(
  source: Blob | ArrayBuffer | ArrayBufferView | URL | string | Source,
  options?: OpenOptions,
): Promise<Drive>;

/**
 * An open stream: a sequence of frames. Iterating over it decodes the frames in order, without the bytes of their
 * files. A call that is made while another one runs waits for it.
 */
export interface Drive extends AsyncIterable<Frame> {
  /** The name of the file, or the URL; empty if there is none. Error messages begin with it. */
  readonly name: string;
  /** Size of the stream in bytes. */
  readonly byteLength: number;
  /** Number of frames. Files that were stored beside the scans (`encode --all`) are not counted. */
  readonly length: number;
  /** What the index contains about each frame, in order. */
  readonly frames: readonly FrameInfo[];

  /**
   * Decodes one frame. Its group of frames is read and decoded from the beginning of the group to this frame. The group
   * that was used last stays in memory, so no frame is decoded twice if frames are read in order.
   *
   * @param number the number of the frame, starting from 0.
   * @param options.file whether to return the bytes of the original file, too. Default: false.
   * @throws {LidarpcError} if there is no such frame, if the input cannot be read or is damaged, if ranges are coded by
   * JPEG or JPEG 2000 (`encode --mode paper`), or if memory is exhausted. In the last case the drive is closed.
   */
  frame(number: number, options?: { file?: boolean }): Promise<Frame>;

  /**
   * The numbers of the frames in the same group as this frame, from `start` to `end`, exclusive. Reads nothing.
   *
   * @throws {LidarpcError} if there is no such frame.
   */
  groupOf(number: number): { start: number; end: number };

  /**
   * The names and sizes of the frames from `start` to `end`, exclusive. Default: all frames. Reads the groups of these
   * frames, but decodes nothing.
   *
   * @throws {LidarpcError} if there are no such frames, or if the input cannot be read or is damaged.
   */
  details(start?: number, end?: number): Promise<FrameDetails[]>;

  /**
   * A description of each scanner that was fitted, as `lidarpc info` prints it. Reads no frames.
   *
   * @throws {LidarpcError} if the input cannot be read or is damaged.
   */
  scanners(): Promise<string[]>;

  /** Releases the decoder and its memory. All later calls that read or decode fail with a `LidarpcError`. */
  close(): void;
}

/** What the index contains about a frame. */
export interface FrameInfo {
  /** Number of the frame, starting from 0. */
  readonly number: number;
  /** What was encoded: a file, a message of a recording, or points in memory. */
  readonly kind: "file" | "message" | "points";
  /** Number of the scanner, starting from 0, if the scans of several scanners alternate. */
  readonly track: number;
  /** When the scan was taken, in nanoseconds since 1970; null if unknown. */
  readonly time: bigint | null;
  /** Size of the coded frame in bytes. */
  readonly codedBytes: number;
}

/** What can be read about a frame without decoding it. */
export interface FrameDetails {
  /** Number of the frame, starting from 0. */
  readonly number: number;
  /** Name of the frame; empty if it has none. It can be any string: check it before you use it as a path. */
  readonly name: string;
  /** Number of points. */
  readonly points: number;
  /** Size in bytes of the original file or message; for points in memory, of their records. */
  readonly bytes: number;
}

/** A decoded scan. Its arrays are copies, which the caller may change. */
export interface Frame {
  /** Number of the frame, starting from 0. */
  readonly number: number;
  /** Name of the frame; empty if it has none. It can be any string: check it before you use it as a path. */
  readonly name: string;
  /** What was encoded: a file, a message of a recording, or points in memory. */
  readonly kind: "file" | "message" | "points";
  /** Number of the scanner, starting from 0, if the scans of several scanners alternate. */
  readonly track: number;
  /** When the scan was taken, in nanoseconds since 1970; null if unknown. */
  readonly time: bigint | null;
  /** Number of points. */
  readonly length: number;
  /**
   * x, y and z of the first point, then of the second, and so on, in metres: three times `length` values, in the order
   * of the points in the file. If the file has coordinates of another type, they are rounded to float32 here, and their
   * exact values are in `fields` as `x`, `y` and `z`. Empty if the file has no positions.
   */
  readonly positions: Float32Array;
  /**
   * All other fields by name, such as `intensity`. The values of a field are in the order of the points; a point has
   * `counts` of the field. The object has no prototype.
   */
  readonly fields: Record<string, TypedArray>;
  /** Number of values per point of each field, by name: 1 for most fields. */
  readonly counts: Record<string, number>;
  /** The range image; null if `rangeImages` was not set or no scanner is known. */
  readonly rangeImage: RangeImage | null;
  /** The bytes of the original file or message; null if they were not requested, or if the frame was points in memory. */
  readonly file: Uint8Array | null;
}

/** The points of a scan as a table: a row for each laser, a column for each azimuth at which the lasers fired. */
export interface RangeImage {
  /** Number of rows. */
  readonly rows: number;
  /** Number of columns. */
  readonly columns: number;
  /**
   * The distance from the laser to the first return of each cell, in metres, row by row: `rows` times `columns` values.
   * 0 where there is no return.
   */
  readonly ranges: Float32Array;
  /**
   * The index of the point in each cell, from 0 to `length - 1`, row by row; -1 where there is none. Records without a
   * measured point can have a cell, too; its range is 0.
   */
  readonly points: Int32Array;
}

/** An error of this package. The message is one line that begins with the name of the file, if there is one. */
export class LidarpcError extends Error {
  constructor(message: string, about?: { file?: string; frame?: number | null; cause?: unknown });
  /** The name of the file, or the URL; empty if there is none. */
  readonly file: string;
  /** The number of the frame that failed; null if the error is not about one frame. */
  readonly frame: number | null;
}
