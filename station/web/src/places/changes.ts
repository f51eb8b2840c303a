// What a person makes of places and rooms: another name, hidden, merged, doors; each change can be taken back.
import { edit } from "../link/api";
import type { PlaceChange, PlaceModel } from "../link/messages";
import { working } from "../ui/toast";
import { LastChange } from "./last_change";

export const lastChange = new LastChange();

export function change(place: PlaceModel, what: Partial<PlaceChange>): Promise<number | null> {
  return edit("PATCH", `/places/${place.id}`, what);
}

/** Do it, and offer for a while to take just that back; later there is the list of navigations and maps. */
export function undoable(work: () => Promise<number | null>): Promise<void> {
  return lastChange.make(work);
}

/** The same of a plan, which is made anew: that takes seconds, and more in a large home. */
export function undoablePlan(work: () => Promise<number | null>): Promise<void> {
  working("The plan is made anew …");
  return undoable(work);
}

/** The same of what led to this version already. */
export function offerUndo(version: number): Promise<void> {
  return undoable(() => Promise.resolve(version));
}
