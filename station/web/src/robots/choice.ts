// Choosing among the station's robots: a list of them, and a dialog for an address that names none of them.
import { findShown } from "../link/address";
import type { RobotEntry } from "../link/messages";
import { by, make } from "../ui/dom";

const NO_SUCH = "No such robot"; // the dialog's name

/** Say that there is no robot of that name, and which there are. */
export function offerOthers(missing: string, robots: RobotEntry[]): void {
  const dialog = by("ask", HTMLDialogElement);
  if (dialog.open && dialog.getAttribute("aria-label") === NO_SUCH) return;
  const entries = robots.map((entry) =>
    make("li", {}, make("a", { class: "small", href: `?robot=${encodeURIComponent(entry.name)}` }, titleOf(entry))),
  );
  dialog.setAttribute("aria-label", NO_SUCH);
  dialog.replaceChildren(
    make("h2", {}, `This station has no robot “${missing}”`),
    make(
      "p",
      { class: "note" },
      `It was renamed, or left out when the station was started anew. ${robots.length === 1 ? "There is this one:" : "There are these:"}`,
    ),
    make("ul", { class: "list" }, ...entries),
  );
  dialog.oncancel = (event) => event.preventDefault(); // behind it nothing works
  dialog.onclose = null;
  if (!dialog.open) dialog.showModal();
}

/** The robot of this address is there: no other one need be chosen (any more). */
export function offerNoOthers(): void {
  const dialog = by("ask", HTMLDialogElement);
  if (dialog.open && dialog.getAttribute("aria-label") === NO_SUCH) dialog.close("");
}

function titleOf(entry: RobotEntry): string {
  return entry.robot.name && entry.robot.name !== entry.name ? `${entry.name} (${entry.robot.name})` : entry.name;
}

/** Fills the list of robots; it is shown when there are several. */
export function showChoice(select: HTMLSelectElement, robots: RobotEntry[]): void {
  const shown = findShown(robots);
  select.replaceChildren(...robots.map((entry) => new Option(titleOf(entry), entry.name, false, entry.name === shown)));
  select.hidden = robots.length < 2;
  select.onchange = () => location.assign(`?robot=${encodeURIComponent(select.value)}`);
}
