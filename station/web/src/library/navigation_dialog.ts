// What can be done with one recorded navigation.
import { call } from "../link/api";
import type { NavigationModel } from "../link/messages";
import { closingButtons } from "../ui/dialogs";
import { by, make, present } from "../ui/dom";
import { count, duration } from "../ui/text";

export interface NavigationActions {
  replay: (navigation: NavigationModel) => Promise<void>;
  remove: () => Promise<void>;
  rename: () => Promise<void>;
}

/** The dialog of a navigation; `others` are the ready ones it can be mapped or compared with. */
export function openNavigation(n: NavigationModel, others: NavigationModel[], actions: NavigationActions): void {
  const dialog = by("navigation-dialog", HTMLDialogElement);
  const button = closingButtons(dialog);
  const boxes = others.map((other) => make("input", { type: "checkbox", value: other.id, id: `with-${other.id}` }));
  const chosen = () => boxes.filter((box) => box.checked).map((box) => box.value);
  const buildMap = button(
    "Build map",
    () => {
      const name = chosen().length ? `Map of ${chosen().length + 1} navigations` : `Map of ${n.name}`;
      return call("POST", "/maps", { navigations: [n.id, ...chosen()], name });
    },
    "primary",
  );
  const compare = button("Compare", () => call("POST", "/comparisons", { first: n.id, second: chosen()[0] }));
  const refresh = () => {
    compare.disabled = chosen().length !== 1;
    buildMap.textContent = chosen().length ? `Build map of ${chosen().length + 1} navigations` : "Build map";
  };
  for (const box of boxes) box.addEventListener("change", refresh);
  refresh();
  const file = (name: string, text: string) =>
    make("a", { class: "small", href: `/navigations/${n.id}/${name}`, download: true }, text);
  const isReady = n.state === "ready";
  dialog.replaceChildren(
    ...present(
      make("h2", {}, n.name),
      make(
        "p",
        { class: "note" },
        isReady
          ? `${duration(n.duration_s)} · ${count(n.frames, "picture")} · ${count(n.landmarks, "landmark")} · SLAM ${n.backend}`
          : n.message,
      ),
      n.frames_skipped > 0 &&
        make(
          "p",
          { class: "note" },
          `Live SLAM left out ${count(n.frames_skipped, "picture")} that the recording has${4 * n.frames_skipped > n.frames ? ": run SLAM again before you build a map of it" : ""}.`,
        ),
      isReady &&
        others.length > 0 &&
        make(
          "fieldset",
          {},
          make("legend", {}, "Together with"),
          ...boxes.map((box, i) => make("label", { for: box.id }, box, others[i]?.name)),
        ),
      make(
        "div",
        { class: "row wrap" },
        make("span", { class: "note" }, "Download"),
        n.recording !== null && file("recording.mcap", "MCAP"),
        isReady && file("trajectory.tum", "TUM"),
        isReady && file("landmarks.ply", "PLY"),
      ),
      make(
        "div",
        { class: "row end wrap" },
        button("Delete", actions.remove, "quiet apart"),
        button("Close", null, "quiet"),
        n.state !== "finishing" && button("Rename", actions.rename),
        n.recording !== null && button("Run SLAM again", () => call("POST", `/navigations/${n.id}/reprocess`, {})),
        n.recording !== null && button("Replay", () => actions.replay(n)),
        isReady && others.length > 0 && compare,
        isReady && buildMap,
      ),
    ),
  );
  dialog.showModal();
}
