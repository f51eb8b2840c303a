// What a person makes of places: another name, hidden, merged; each change can be taken back.
import { call } from "../link/api";
import type { PlaceChange, PlaceModel, PlacesChangeModel } from "../link/messages";
import { toast, working } from "../ui/toast";

export function change(place: PlaceModel, what: Partial<PlaceChange>): Promise<PlaceModel> {
  return call("PATCH", `/places/${place.id}`, what);
}

export function undo(made: PlacesChangeModel): Promise<unknown> {
  return call("POST", "/places/undo", { version: made.version });
}

/** Do it, and offer for a while to take just that back; later there is the list of navigations and maps. */
export async function undoable(work: () => Promise<unknown>): Promise<void> {
  await work();
  await offerUndo();
}

/** The same of a plan, which is made anew: that takes seconds, and more in a large home. */
export function undoablePlan(work: () => Promise<unknown>): Promise<void> {
  working("The plan is made anew …");
  return undoable(work);
}

export async function offerUndo(): Promise<void> {
  const [made] = await call<PlacesChangeModel[]>("GET", "/places/changes");
  if (made) toast(`${made.why}.`, { label: "Undo", act: () => undo(made) });
}
