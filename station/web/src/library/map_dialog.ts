// What can be done with one map.
import type { MapModel } from "../link/messages";
import { closingButtons } from "../ui/dialogs";
import { by, make, present } from "../ui/dom";
import { count } from "../ui/text";

export interface MapActions {
  use: (id: string | null) => Promise<unknown>;
  rename: () => Promise<void>;
}

export function openMap(m: MapModel, actions: MapActions): void {
  const dialog = by("map-dialog", HTMLDialogElement);
  const button = closingButtons(dialog);
  const file = (href: string, name: string, text: string) => make("a", { class: "small", href, download: name }, text);
  dialog.replaceChildren(
    ...present(
      make("h2", {}, m.name),
      make(
        "p",
        { class: "note" },
        m.active
          ? `${count(m.places, "place")} · in use: the current place is looked for in it${m.first ? "" : ", too"}.`
          : `${count(m.places, "place")} · use it to see them, and to ask where the robot is.`,
      ),
      make(
        "div",
        { class: "row wrap" },
        make("span", { class: "note" }, "Download"),
        m.first && file("/graph?format=graphml", `${m.id}.graphml`, "GraphML"),
        file(`/maps/${m.id}/landmarks?format=ply`, `${m.id}.ply`, "PLY"),
      ),
      make(
        "div",
        { class: "row end wrap" },
        button("Close", null, "quiet apart"),
        button("Rename", actions.rename),
        m.first
          ? button("Use no map", () => actions.use(null))
          : button(m.active ? "Use alone" : "Use", () => actions.use(m.id), "primary"),
      ),
    ),
  );
  dialog.showModal();
}
