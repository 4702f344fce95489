/** Pictures of frames, wherever they are: in the file, in a folder beside it, or from a run in progress. */

import type { Column } from "./data/column";
import { bytesOf, type Opened } from "./data/packed";

export interface Picture {
  image: CanvasImageSource;
  /** The frame that it is of: not every frame has one. */
  frame: number;
}

export interface Pictures {
  /** Why there are none, in words; empty where there are some. */
  readonly without: string;
  readonly annotated: boolean;
  /** The picture of a frame in a camera, or of the nearest earlier one that has one. */
  of(frame: number, camera?: string): Promise<Picture | null>;
}

export function none(without: string): Pictures {
  return { without, annotated: false, of: async () => null };
}

/** Keeps the last few pictures that were made. */
class Shelf {
  private readonly kept = new Map<number, Promise<CanvasImageSource | null>>();

  constructor(
    private readonly make: (row: number) => Promise<CanvasImageSource>,
    private readonly most = 240,
  ) {}

  get(row: number): Promise<CanvasImageSource | null> {
    let found = this.kept.get(row);
    if (found === undefined) {
      found = this.make(row).catch(() => null);
      this.kept.set(row, found);
      for (const old of this.kept.keys()) {
        if (this.kept.size <= this.most) break;
        this.kept.delete(old);
      }
    }
    return found;
  }
}

export async function picturesOf({ header, columns }: Opened): Promise<Pictures> {
  const about = header.pictures;
  const cameras = ["", ...(header.cameras ?? []).map((camera) => camera.name)];
  const shelves = new Map<string, { frames: Column; shelf: Shelf }>();
  const bytes = about?.where === "file" ? await embedded() : null;
  for (const camera of cameras) {
    const part = camera === "" ? "" : `${camera}/`;
    const frames = columns.get(`pictures/${part}frame`);
    if (about === undefined || frames === undefined || frames.length === 0) continue;
    const ends = columns.get(`pictures/${part}end`);
    const make = bytes === null ? fromFolder(frames, part) : fromFile(bytes, ends!, about.starts?.[camera] ?? 0);
    shelves.set(camera, { frames, shelf: new Shelf(make) });
  }
  if (about === undefined || shelves.size === 0) return none(about?.without ?? "");
  return {
    without: "",
    annotated: about.annotated,
    async of(frame, camera = "") {
      const found = shelves.get(camera);
      if (found === undefined) return null;
      const row = Math.max(0, lastAtMost(found.frames, frame));
      const image = await found.shelf.get(row);
      return image === null ? null : { image, frame: found.frames.at(row) };
    },
  };
}

/** All pictures that stand in the file, behind the script, so that the page is there before they are read. */
async function embedded(): Promise<Uint8Array<ArrayBuffer>> {
  if (document.readyState === "loading") {
    await new Promise((done) => document.addEventListener("DOMContentLoaded", done, { once: true }));
  }
  return bytesOf(document.getElementById("run-pictures")?.textContent ?? "");
}

function fromFile(bytes: Uint8Array<ArrayBuffer>, ends: Column, start: number): (row: number) => Promise<CanvasImageSource> {
  return (row) => {
    const picture = bytes.subarray(row > 0 ? ends.at(row - 1) : start, ends.at(row));
    return createImageBitmap(new Blob([picture], { type: "image/jpeg" }));
  };
}

function fromFolder(frames: Column, part: string): (row: number) => Promise<CanvasImageSource> {
  return async (row) => {
    const image = new Image();
    image.src = `frames/${part}${String(frames.at(row)).padStart(6, "0")}.jpg`;
    await image.decode();
    return image;
  };
}

/** From a run in progress: not every frame has a picture, and which have one changes while it goes on. */
export function fromServer(): Pictures {
  const kept = new Map<number, CanvasImageSource>();
  return {
    without: "",
    annotated: false,
    async of(frame) {
      const there = kept.get(frame);
      if (there !== undefined) return { image: there, frame };
      try {
        const answer = await fetch(`picture?frame=${frame}`, { cache: "no-store" });
        if (answer.status !== 200) return null;
        const of = Number(answer.headers.get("X-Frame"));
        const image = kept.get(of) ?? (await createImageBitmap(await answer.blob()));
        kept.set(of, image);
        for (const old of kept.keys()) {
          if (kept.size <= 240) break;
          kept.delete(old);
        }
        return { image, frame: of };
      } catch {
        return null;
      }
    },
  };
}

function lastAtMost(frames: Column, frame: number): number {
  let [low, high] = [0, frames.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (frames.at(middle) <= frame) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}
