/** Every reconfiguration, in a list that follows the frame. */

import { useSignalEffect } from "@preact/signals";
import { useRef } from "preact/hooks";
import type { State } from "../state";
import { Mark, What } from "./moment";
import { plural } from "./words";

const MOST = 300;

export function Events({ state }: { state: State }) {
  const list = useRef<HTMLOListElement>(null);
  const events = state.stops.value;
  const frame = state.frame.value;
  const current = events.findLastIndex((event) => event.frame <= frame);
  const from = Math.max(0, Math.min(current - MOST / 2, events.length - MOST));
  const shown = events.slice(from, from + MOST);
  useSignalEffect(() => {
    void state.frame.value;
    requestAnimationFrame(() => {
      const box = list.current;
      const item = box?.querySelector<HTMLElement>("[data-last]");
      if (!box || !item) return;
      const [top, bottom] = [item.offsetTop, item.offsetTop + item.offsetHeight];
      if (top < box.scrollTop || bottom > box.scrollTop + box.clientHeight) box.scrollTop = top - box.clientHeight / 3;
    });
  });
  const notes = state.events.value.filter((event) => event.sort === "note").length;
  return (
    <section class="events" aria-label="What happened">
      <header>
        <h2>What happened, and why</h2>
        {notes > 0 && (
          <label>
            <input
              type="checkbox"
              checked={state.notes.value}
              onChange={() => (state.notes.value = !state.notes.value)}
            />
            with {plural(notes, "note")}
          </label>
        )}
      </header>
      <ol ref={list}>
        {from > 0 && <li class="more">{from} earlier ones: they show as you go back</li>}
        {shown.map((event, index) => (
          <li key={from + index} data-last={from + index === current ? "" : undefined} aria-current={event.frame === frame ? "step" : undefined}>
            <button type="button" onClick={() => state.show(event)}>
              <span class="at">{event.frame}</span>
              <Mark event={event} />
              <span class="what">
                <What text={event.what} />
                {event.why !== "" && <span class="why">{event.why}</span>}
                {event.unless !== "" && <span class="unless">{event.unless}</span>}
              </span>
            </button>
          </li>
        ))}
        {from + MOST < events.length && <li class="more">{events.length - from - MOST} later ones</li>}
        {events.length === 0 && <li class="more">Nothing was reconfigured.</li>}
      </ol>
    </section>
  );
}
