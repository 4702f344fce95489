/** Paints what is believed of targets over a picture. Lengths are px of the source; (x, y) of boxes is the centre. */

import type { RunData, Track } from "../data/run";
import type { Layer } from "../state";
import { nameOf, short } from "./words";

/** The ink of a box: green says that it is on the target, which a score that was not fitted cannot tell. */
export function inkOf(track: { calibrated: boolean }, status: string): string {
  if (status === "tracking" && !track.calibrated) return INK.followed;
  return INK[status as "tracking"] ?? INK.tracking;
}

export const INK = { followed: "#b9c7d8", tracking: "#4ade9b", uncertain: "#ffc933", lost: "#ff7a59", hidden: "#b79cff", cloud: "#6fd3ff", truth: "#ffffff", shape: "#ffd9a0" };
/** Colours of targets that several cameras see, which can be told apart on dark images; the same everywhere. */
const TARGETS = ["#6fd3ff", "#ffc933", "#4ade9b", "#ff8a65", "#c7a6ff", "#f7a8e8", "#d7f06a", "#ffffff", "#ffb86b", "#7df0e0"];

export function inkOfTarget(track: { place: number }): string {
  return TARGETS[track.place % TARGETS.length]!;
}

export const DASH: Record<string, number[]> = { tracking: [], uncertain: [8, 4], lost: [2, 4], hidden: [2, 4] };
const HALO = "rgba(10,14,20,.75)";

/** The part of the source that is shown, and how large. */
export interface View {
  x: number;
  y: number;
  scale: number;
}

export class Painter {
  constructor(
    readonly g: CanvasRenderingContext2D,
    readonly view: View,
  ) {}

  x(value: number): number {
    return (value + 0.5 - this.view.x) * this.view.scale;
  }

  y(value: number): number {
    return (value + 0.5 - this.view.y) * this.view.scale;
  }

  /** Everything of the selected target. */
  target(run: RunData, track: Track, row: number, layers: ReadonlySet<Layer>): void {
    const { g } = this;
    const status = track.status(row);
    const ink = inkOf(track, status);
    if (layers.has("cloud")) this.cloud(track.cloud(row));
    if (layers.has("regions")) {
      this.region(track.values("region90", row), [5, 4]);
      this.region(track.values("region50", row), []);
    }
    if (layers.has("truth")) this.truth(run, track, row);
    if (layers.has("parts")) {
      for (const part of track.parts) {
        const seen = track.value(`parts/${part}/status`, row) === 3;
        this.box(track.values(`parts/${part}/box`, row), "#f5b3ee", 1.5, seen ? [] : [3, 3]);
      }
    }
    if (layers.has("map")) this.cross(track.values("map", row));
    this.box(track.values("box", row), ink, 2.5, DASH[status] ?? [], track.value("angle", row));
    const box = track.values("box", row);
    g.font = "600 13px system-ui, sans-serif";
    const word = `${nameOf(track)} ${status} · UD ${short(track.value("ud_px2", row))} ${run.udUnit(track)}`;
    this.label(word, box, ink);
  }

  /** The line or the polygon of a query, with its name at the first corner. */
  shape(name: string, corners: [number, number][]): void {
    if (corners.length === 0) return;
    const { g } = this;
    g.save();
    g.beginPath();
    for (const [x, y] of corners) g.lineTo(this.x(x), this.y(y));
    if (corners.length > 2) g.closePath();
    this.strokeTwice(INK.shape);
    g.restore();
    g.font = "600 11px system-ui, sans-serif";
    this.label(name, [...corners[0]!, 0, 0], INK.shape);
  }

  /** A target that is not selected. */
  other(track: Track, row: number): void {
    const status = track.status(row);
    const box = track.values("box", row);
    this.box(box, inkOf(track, status), 1.25, DASH[status] ?? []);
    this.g.font = "600 11px system-ui, sans-serif";
    this.label(track.id, box, "#e8edf3");
  }

  /** Stroke the current path in an ink, on a halo that sets it off from any picture. */
  private strokeTwice(ink: string): void {
    for (const [style, width] of [
      [HALO, 4],
      [ink, 2],
    ] as const) {
      this.g.strokeStyle = style;
      this.g.lineWidth = width;
      this.g.stroke();
    }
  }

  /** A line between two targets that may be each other, with the probability. */
  doubt(from: number[], to: number[], probability: number): void {
    const { g } = this;
    const [ax, ay, bx, by] = [this.x(from[0]!), this.y(from[1]!), this.x(to[0]!), this.y(to[1]!)];
    if (!Number.isFinite(ax + ay + bx + by)) return;
    g.save();
    g.beginPath();
    g.moveTo(ax, ay);
    g.lineTo(bx, by);
    this.strokeTwice(INK.uncertain);
    g.restore();
    g.font = "600 11px system-ui, sans-serif";
    const lower = Math.max(from[1]! + from[3]! / 2, to[1]! + to[3]! / 2);
    const place = [(from[0]! + to[0]!) / 2, lower + 26 / this.view.scale, 0, 0];
    this.label(`swapped? ${probability.toFixed(2)}`, place, INK.uncertain);
  }

  /** A target in the image of one of several cameras; (4,) NaN where it is not in it. */
  seen(track: Track, row: number, camera: string, chosen: boolean): void {
    const box = track.values(`cameras/${camera}`, row);
    const status = track.status(row);
    const ink = inkOfTarget(track);
    this.box(box, ink, chosen ? 3 : 1.5, DASH[status] ?? []);
    this.g.font = `${chosen ? 700 : 600} 11px system-ui, sans-serif`;
    const isRoomy = (this.g.canvas.clientWidth || this.g.canvas.width) > 360;
    this.label(chosen && isRoomy ? `${nameOf(track)} ${status}` : track.id, box, ink);
  }

  private cloud(boxes: number[][]): void {
    const { g } = this;
    g.save();
    g.strokeStyle = INK.cloud;
    g.lineWidth = 1;
    g.globalAlpha = Math.min(0.22, 5 / Math.max(1, boxes.length));
    for (const [x, y, w, h] of boxes as [number, number, number, number][]) {
      g.strokeRect(this.x(x - w / 2), this.y(y - h / 2), w * this.view.scale, h * this.view.scale);
    }
    const radius = Math.max(1.8, Math.min(3, this.view.scale * 0.9));
    for (const [fill, grown, alpha] of [
      [HALO, 0.9, 0.6],
      [INK.cloud, 0, 0.85],
    ] as const) {
      g.globalAlpha = alpha;
      g.fillStyle = fill;
      g.beginPath();
      for (const [x, y] of boxes as [number, number][]) {
        g.moveTo(this.x(x) + radius + grown, this.y(y));
        g.arc(this.x(x), this.y(y), radius + grown, 0, 2 * Math.PI);
      }
      g.fill();
    }
    g.restore();
  }

  private region(bounds: number[], dash: number[]): void {
    const [left, right, top, bottom] = bounds as [number, number, number, number];
    if (!Number.isFinite(left + right + top + bottom)) return;
    const [x, y] = [this.x(left), this.y(top)];
    const [w, h] = [this.x(right) - x, this.y(bottom) - y];
    const { g } = this;
    g.save();
    g.beginPath();
    g.roundRect(x, y, w, h, Math.min(w, h) * 0.45);
    g.fillStyle = "rgba(111,211,255,.10)";
    g.fill();
    g.setLineDash(dash);
    g.lineWidth = 1.4;
    g.strokeStyle = "#d5f1ff";
    g.stroke();
    g.restore();
  }

  private truth(run: RunData, track: Track, row: number): void {
    if (run.truth === null || run.truthTarget !== track.id) return;
    const [x, y, w, h] = run.truth.row(track.value("frame", row)) as [number, number, number, number];
    if (Number.isFinite(x)) this.box([x + (w - 1) / 2, y + (h - 1) / 2, w, h], INK.truth, 1.25, [2, 3]);
  }

  private cross(box: number[]): void {
    const [x, y] = [this.x(box[0]!), this.y(box[1]!)];
    const { g } = this;
    for (const [style, width] of [
      [HALO, 4],
      ["#ffffff", 1.8],
    ] as const) {
      g.strokeStyle = style;
      g.lineWidth = width;
      g.beginPath();
      g.moveTo(x - 6, y);
      g.lineTo(x + 6, y);
      g.moveTo(x, y - 6);
      g.lineTo(x, y + 6);
      g.stroke();
    }
  }

  private box(box: number[], ink: string, width: number, dash: number[], angle = 0): void {
    const [x, y, w, h] = box as [number, number, number, number];
    if (!Number.isFinite(x + y + w + h)) return;
    const { g } = this;
    g.save();
    g.translate(this.x(x), this.y(y));
    if (angle) g.rotate((angle * Math.PI) / 180);
    const s = this.view.scale;
    for (const [style, grown, pattern] of [
      [HALO, 2, []],
      [ink, 0, dash],
    ] as const) {
      g.strokeStyle = style;
      g.lineWidth = width + grown;
      g.setLineDash([...pattern]);
      g.strokeRect((-w / 2) * s, (-h / 2) * s, w * s, h * s);
    }
    g.restore();
  }

  /** On a dark plate above the box, or below it where there is no room. */
  private label(text: string, box: number[], ink: string): void {
    const { g } = this;
    const [x, y, w, h] = box as [number, number, number, number];
    if (!Number.isFinite(x + y + w + h)) return;
    const size = Number(/(\d+)px/.exec(g.font)?.[1] ?? 12);
    const [wide, high] = [g.measureText(text).width + 10, size + 7];
    const room = g.canvas.clientWidth || g.canvas.width;
    const tall = g.canvas.clientHeight || g.canvas.height;
    const left = Math.min(Math.max(this.x(x - w / 2), 2), Math.max(room - wide - 2, 2));
    let top = this.y(y - h / 2) - high - 4;
    if (top < 2) top = Math.min(this.y(y + h / 2) + 4, tall - high - 2);
    g.fillStyle = "rgba(12,17,24,.78)";
    g.beginPath();
    g.roundRect(left, top, wide, high, 4);
    g.fill();
    g.fillStyle = ink;
    g.textBaseline = "middle";
    g.fillText(text, left + 5, top + high / 2 + 0.5);
  }
}
