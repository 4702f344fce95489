/** What the person looks at: the frame, the target, the stretch of time; and what moves it. */

import { batch, computed, signal } from "@preact/signals";
import type { RunData, Track } from "./data/run";
import type { EventRow } from "./data/types";
import type { Pictures } from "./pictures";

export type Layer = "cloud" | "regions" | "map" | "parts" | "truth" | "others";

export class State {
  readonly frame = signal(0);
  readonly target = signal("");
  readonly playing = signal(false);
  readonly speed = signal(1);
  /** First and last frame of the timelines. */
  readonly stretch = signal<[number, number]>([0, 0]);
  readonly layers = signal<ReadonlySet<Layer>>(
    new Set<Layer>(["cloud", "regions", "map", "parts", "truth", "others"]),
  );
  readonly close = signal(false);
  readonly help = signal(false);
  readonly notes = signal(false);
  /** Counts the batches that were added to the run. */
  readonly version = signal(0);
  readonly pictures = signal<Pictures | null>(null);
  /** Counts what else calls for drawing again: another colour scheme, another size. */
  readonly look = signal(0);

  readonly track = computed<Track | undefined>(() => {
    this.version.value;
    return this.run.tracks.get(this.target.value);
  });
  readonly row = computed(() => {
    this.version.value;
    return this.track.value?.rowOf(this.frame.value) ?? -1;
  });
  readonly events = computed<EventRow[]>(() => {
    this.version.value;
    return this.run.eventsOf(this.target.value);
  });
  /** Those that one steps through. */
  readonly stops = computed<EventRow[]>(() => this.events.value.filter((e) => this.notes.value || e.sort !== "note"));

  constructor(readonly run: RunData) {
    this.target.value = [...run.tracks.keys()][0] ?? "";
    this.frame.value = run.first;
    this.stretch.value = [run.first, run.last];
    run.onChange(() =>
      batch(() => {
        const [from, to] = this.stretch.value;
        const followed = this.frame.value;
        if (this.target.value === "") this.target.value = [...run.tracks.keys()][0] ?? "";
        if (from <= run.first) this.stretch.value = [run.first, Math.max(to, run.last)];
        // Who looks at the newest frame goes on looking at the newest.
        if (followed >= this.newest) this.frame.value = run.last;
        this.newest = run.last;
        this.version.value += 1;
      }),
    );
    this.newest = run.last;
  }

  private newest = 0;

  go(frame: number): void {
    const to = Math.min(Math.max(Math.round(frame), this.run.first), this.run.last);
    batch(() => {
      this.frame.value = to;
      const [from, until] = this.stretch.value;
      if (to < from || to > until) {
        const span = until - from;
        const start = Math.min(Math.max(to - Math.round(span / 2), this.run.first), this.run.last - span);
        this.stretch.value = [start, start + span];
      }
    });
  }

  step(by: number): void {
    this.playing.value = false;
    this.go(this.frame.value + by);
  }

  /** To the next (1) or the previous (-1) frame in which something happened. */
  stop(direction: 1 | -1): void {
    this.playing.value = false;
    const frames = this.stops.value.map((event) => event.frame);
    const here = this.frame.value;
    const beyond = frames.filter((frame) => (direction > 0 ? frame > here : frame < here));
    if (beyond.length > 0) this.go(direction > 0 ? Math.min(...beyond) : Math.max(...beyond));
  }

  /** To an event: its frame and its target. */
  show(event: EventRow): void {
    batch(() => {
      this.playing.value = false;
      if (event.target !== undefined && event.target !== this.target.value && event.other !== this.target.value) {
        if (this.run.tracks.has(event.target)) this.target.value = event.target;
      }
      this.go(event.frame);
    });
  }

  /** Show a shorter (factor below 1) or longer stretch around the frame. */
  zoom(factor: number): void {
    const [from, to] = this.stretch.value;
    const whole = this.run.last - this.run.first;
    const span = Math.min(Math.max((to - from) * factor, Math.min(20, whole)), whole);
    const share = to > from ? (this.frame.value - from) / (to - from) : 0.5;
    const start = Math.min(Math.max(this.frame.value - share * span, this.run.first), this.run.last - span);
    this.stretch.value = [Math.round(start), Math.round(start + span)];
  }

  toggle(layer: Layer): void {
    const next = new Set(this.layers.value);
    if (!next.delete(layer)) next.add(layer);
    this.layers.value = next;
  }

  other(direction: 1 | -1): void {
    const ids = [...this.run.tracks.keys()];
    const at = ids.indexOf(this.target.value);
    this.target.value = ids[(at + direction + ids.length) % ids.length] ?? "";
  }
}
