// What can be done with one place.
import { edit } from "../link/api";
import type { PlaceModel } from "../link/messages";
import { askUntil, closingButtons } from "../ui/dialogs";
import { by, make, present } from "../ui/dom";
import { count, percent } from "../ui/text";
import { change, offerUndo, undoable } from "./changes";

/** Everything known of one place, and what can be made of it; `others` are those it can be merged with. */
export function openPlace(place: PlaceModel, others: PlaceModel[]): void {
  const dialog = by("place-dialog", HTMLDialogElement);
  const picture = (path: string | null, text: string) =>
    path &&
    make(
      "figure",
      {},
      make("img", { src: path, alt: `${text} picture of ${place.name}` }),
      make("figcaption", {}, text),
    );
  const button = closingButtons(dialog);
  const rename = button("Rename", () => renamePlace(place), "primary");
  rename.autofocus = true;
  const hide = () => undoable(() => change(place, { hidden: true }));
  const nobody = make("option", { value: "", selected: true }, "choose a place");
  const select = make(
    "select",
    { id: "merge-with" },
    nobody,
    ...others.map((p) => make("option", { value: p.id }, p.name)),
  );
  const merge = button("Merge", () =>
    undoable(() => edit("POST", "/places/merge", { places: [place.id, select.value] })),
  );
  merge.disabled = true;
  select.addEventListener("change", () => (merge.disabled = !select.value));
  dialog.replaceChildren(
    ...present(
      make("h2", {}, place.name),
      make(
        "div",
        { class: "evidence three" },
        picture(place.representative_image, "representative"),
        picture(place.mean_image, "mean"),
        picture(place.deviation_image, "deviation"),
      ),
      make(
        "p",
        { class: "note" },
        `${count(place.landmarks, "landmark")} · seen in ${count(place.images, "picture")} · quality ${percent(place.quality)}`,
      ),
      others.length > 0 &&
        make("div", { class: "row merge" }, make("label", { for: "merge-with" }, "Same place as"), select, merge),
      make("div", { class: "row end" }, button("Close", null, "quiet apart"), button("Hide", hide), rename),
    ),
  );
  dialog.showModal();
}

async function renamePlace(place: PlaceModel): Promise<void> {
  const save = async (name: string) => (name === place.name ? null : change(place, { name }));
  const version = await askUntil("Name this place", "Save", { label: "Name", value: place.name }, save);
  if (version !== null) await offerUndo(version);
}
