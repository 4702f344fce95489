/** A page's data as it stands in the file: gzip of a header in JSON and columns of numbers, in base64. */

import { Column, KINDS, type Kind } from "./column";
import { RunData, Track } from "./run";
import type { Header } from "./types";

interface PackedHeader extends Header {
  columns: Record<string, [Kind, number, number, number]>;
}

export interface Opened {
  run: RunData;
  header: Header;
  columns: Map<string, Column>;
}

export function bytesOf(base64: string): Uint8Array<ArrayBuffer> {
  const quick = (Uint8Array as unknown as { fromBase64?: (text: string) => Uint8Array<ArrayBuffer> }).fromBase64;
  if (quick) return quick.call(Uint8Array, base64);
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k += 1) bytes[k] = text.charCodeAt(k);
  return bytes;
}

export async function open(packed: Uint8Array<ArrayBuffer>): Promise<Opened> {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length))) as PackedHeader;
  const start = Math.ceil((4 + length) / 8) * 8;
  const columns = new Map<string, Column>();
  for (const [name, [kind, width, count, offset]] of Object.entries(header.columns)) {
    columns.set(name, new Column(new KINDS[kind](buffer, start + offset, count), width));
  }
  return { run: makeRun(header, columns), header, columns };
}

function makeRun(header: Header, columns: Map<string, Column>): RunData {
  const run = new RunData(header);
  const tracks = header.targets.map((target) => Object.assign(new Track(target.id, target.plate), target));
  for (const [name, column] of columns) {
    const cut = name.indexOf("/");
    const [owner, rest] = [name.slice(0, cut), name.slice(cut + 1)];
    if (owner === "run" && rest === "truth") run.truth = column;
    else if (owner === "run") run.clock.set(rest, column);
    else tracks[Number(owner)]?.columns.set(rest, column);
  }
  run.thinned = header.thinned ?? null;
  for (const track of tracks) {
    track.gap = run.thinned?.step ?? 1;
    run.add(track);
  }
  for (const event of header.events) run.addEvent(event);
  run.truthTarget = run.truth === null ? null : (header.truth_target ?? null);
  run.measure();
  return run;
}
