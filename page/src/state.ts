/** What the person looks at: the frame, the target, the stretch of time; and what moves it. */

import { batch, computed, signal } from "@preact/signals";
import type { Control } from "./control";
import type { RunData, Track } from "./data/run";
import type { EventRow } from "./data/types";
import type { Pictures } from "./pictures";

export type Layer = "cloud" | "regions" | "map" | "parts" | "truth" | "others" | "shapes" | "ellipses" | "trails" | "fields";

export class State {
  readonly frame = signal(0);
  readonly target = signal("");
  /** The node of the net whose parameters and band are shown. */
  readonly node = signal<string | null>(null);
  readonly playing = signal(false);
  readonly speed = signal(1);
  /** First and last frame of the timelines. */
  readonly stretch = signal<[number, number]>([0, 0]);
  readonly layers = signal<ReadonlySet<Layer>>(
    new Set<Layer>(["cloud", "regions", "map", "parts", "truth", "others", "shapes", "ellipses", "trails", "fields"]),
  );
  readonly close = signal(false);
  /** Of several cameras the one that is large, or "ground"; empty: none. */
  readonly camera = signal("");
  readonly help = signal(false);
  readonly notes = signal(false);
  /** Counts the batches that were added to the run. */
  readonly version = signal(0);
  /** The same, less often: for what takes long to draw. */
  readonly settled = signal(0);
  /** Whether the newest frame is looked at, and the next newest will be. */
  readonly following = signal(true);
  /** The run in progress; null where it is over. */
  live: Control | null = null;
  readonly pictures = signal<Pictures | null>(null);
  /** Counts what else calls for drawing again: another colour scheme, another size. */
  readonly look = signal(0);

  readonly count = computed(() => {
    this.version.value;
    return this.run.tracks.size;
  });
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
    this.following.value = run.first >= run.last;
    run.onChange(() => {
      batch(() => {
        const [from, to] = this.stretch.value;
        if (this.target.value === "") this.target.value = [...run.tracks.keys()][0] ?? "";
        // A stretch that reaches the end goes on reaching it.
        if (from <= this.start) this.stretch.value = [run.first, Math.max(to, run.last)];
        else if (to >= this.end) this.stretch.value = [from + run.last - to, run.last];
        [this.start, this.end] = [run.first, run.last];
        this.version.value += 1;
        this.follow();
      });
      this.settle();
    });
    [this.start, this.end] = [run.first, run.last];
  }

  private start = 0;
  private end = 0;
  private due: ReturnType<typeof setTimeout> | null = null;
  private pace = 400;
  private isFetching = false;

  /** The newest frame to look at: while a run goes on, pictures come a little later than numbers. */
  get head(): number {
    const pictured = this.live?.status.value?.pictured ?? -1;
    const isNear = pictured >= this.run.first && pictured <= this.run.last && pictured > this.run.last - 50;
    return isNear ? pictured : this.run.last;
  }

  /** Who looks at the newest frame goes on looking at the newest, once its picture is there: boxes fit it then. */
  follow(): void {
    if (!this.following.value || this.isFetching) return;
    const to = this.head;
    const shown = this.pictures.value?.of(to);
    if (shown === undefined) {
      this.frame.value = to;
      return;
    }
    this.isFetching = true;
    void shown.finally(() => {
      this.isFetching = false;
      if (!this.following.value) return;
      this.frame.value = to;
      if (this.head !== to) this.follow();
    });
  }

  /** To the newest frame, and on with it. */
  goLive(): void {
    batch(() => {
      this.playing.value = false;
      this.go(this.head);
    });
  }

  /** Let what takes long be drawn again soon: the longer it takes, the more seldom, and never under a finger. */
  private settle(): void {
    if (this.due !== null) return;
    this.due = setTimeout(() => {
      this.due = null;
      if (this.live?.isHeld) return this.settle();
      const began = performance.now();
      this.settled.value += 1;
      this.pace = Math.max(400, 8 * (performance.now() - began));
    }, this.pace);
  }

  go(frame: number): void {
    const to = Math.min(Math.max(Math.round(frame), this.run.first), this.run.last);
    batch(() => {
      this.frame.value = to;
      this.following.value = to >= this.head;
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
