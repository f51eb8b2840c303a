// One room: its name, names that something seen speaks for, and rooms that it is one with.
import { call, edit } from "../link/api";
import type { FloorPlanModel, NameSuggestionModel, PlanRoom, RoomModel } from "../link/messages";
import { closingButtons } from "../ui/dialogs";
import { by, make, present, setText } from "../ui/dom";
import { count, percent, sentence } from "../ui/text";
import { offerUndo, undoablePlan } from "../places/changes";

/**
 * Ask for its name first: whoever presses a room most likely wants to name it. At once, with what the plan knows: a phone
 * shows its keyboard for what a finger has just pressed only. The rest follows.
 */
export async function openRoom(room: PlanRoom, plan: FloorPlanModel): Promise<void> {
  const dialog = by("room-dialog", HTMLDialogElement);
  const input = make("input", {
    value: room.named ? room.name : "",
    maxlength: "80",
    required: !room.named, // empty: it shall have none any more
    id: "room-name",
    autocomplete: "off",
    autocapitalize: "sentences",
    enterkeyhint: "done",
  });
  input.placeholder = room.name;
  const why = make("p", { class: "note bad", role: "alert" });
  const form = make(
    "form",
    { method: "dialog", class: "row naming" },
    make("label", { for: "room-name" }, "Name"),
    input,
    make("button", { type: "submit", class: "primary" }, "Save"),
  );
  const name = async (text: string) => {
    if (!text && !room.named) {
      dialog.close(); // it has no name, and shall have none
      return;
    }
    let version: number | null = null;
    try {
      if (text !== room.name || !room.named) version = await edit("PATCH", `/rooms/${room.id}`, { name: text || null });
    } catch (error) {
      setText(why, sentence(error)); // the dialog stays, for another name
      return;
    }
    dialog.close();
    if (version !== null) await offerUndo(version);
  };
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void name(input.value.trim());
  });
  const button = closingButtons(dialog);
  const about = make("p", { class: "note" }, "…");
  dialog.replaceChildren(
    ...present(
      make("h2", {}, room.name),
      about,
      form,
      why,
      mergeRow(room, plan, button),
      make(
        "div",
        { class: "row end" },
        room.named &&
          make("button", { type: "button", class: "quiet apart", onclick: () => void name("") }, "Remove name"),
        button("Close", null, "quiet"),
      ),
    ),
  );
  dialog.showModal();
  input.focus();
  const known = await call<RoomModel>("GET", `/rooms/${room.id}`).catch((error: unknown) => {
    if (dialog.contains(form)) dialog.close(); // it is gone; another room's stays
    throw error;
  });
  setText(about, describe(known));
  if (known.suggestions.length > 0) why.after(suggestions(known.suggestions, (text) => void name(text)));
}

function describe(room: RoomModel): string {
  const area = room.area_m2 === null ? [] : [`${room.area_m2.toFixed(1)} m²`];
  return [...area, count(room.doors.length, "door"), count(room.places.length, "place")].join(" · ");
}

const SOURCES: Record<NameSuggestionModel["source"], string> = {
  sticker: "sticker",
  "door plate": "printed word",
  model: "model",
  "other map": "another map",
};

function suggestions(all: NameSuggestionModel[], use: (name: string) => void): HTMLElement {
  return make(
    "ul",
    { class: "suggestions", "aria-label": "Suggested names" },
    ...all.map((s) =>
      make(
        "li",
        {},
        s.image !== null &&
          make(
            "a",
            { href: s.image, target: "_blank", rel: "noopener", title: "The whole picture" },
            make("img", { src: s.image, alt: `The picture that speaks for ${s.name}` }),
          ),
        make(
          "p",
          { class: "name" },
          make("strong", {}, s.name),
          make("span", { class: "source" }, `${SOURCES[s.source]} · ${percent(s.confidence)}`),
        ),
        make("p", { class: "note" }, s.reason),
        make("button", { type: "button", class: "small", onclick: () => use(s.name) }, "Use it"),
      ),
    ),
  );
}

/** Rooms behind its doors: with each of them it may be one. */
function mergeRow(
  room: PlanRoom,
  plan: FloorPlanModel,
  button: ReturnType<typeof closingButtons>,
): HTMLElement | false {
  const beside = new Set(plan.doors.filter((d) => d.rooms.includes(room.id)).flatMap((d) => d.rooms));
  const others = plan.rooms.filter((r) => r.id !== room.id && beside.has(r.id));
  if (!others.length) return false;
  const select = make(
    "select",
    { id: "one-room-with" },
    make("option", { value: "", selected: true }, "choose a room"),
    ...others.map((r) => make("option", { value: r.id }, r.name)),
  );
  // The first one's name is kept: the pressed room's, unless only the other one was named by a person.
  const chosen = () => others.filter((r) => r.id === select.value);
  const inOrder = () => [room, ...chosen()].sort((a, b) => Number(b.named) - Number(a.named)).map((r) => r.id);
  const merge = button("Merge", () => undoablePlan(() => edit("POST", "/rooms/merge", { rooms: inOrder() })));
  merge.disabled = true;
  select.addEventListener("change", () => (merge.disabled = !select.value));
  return make("div", { class: "row merge" }, make("label", { for: "one-room-with" }, "One room with"), select, merge);
}
