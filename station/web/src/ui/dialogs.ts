// Questions to the person at the page.
import { by, make, setText } from "./dom";
import { sentence } from "./text";

export interface Field {
  label: string;
  value: string;
  isNumber?: boolean;
}

/** Ask for some texts or numbers, or for consent when there is no field. Null when the person changes their mind. */
export function askAll(
  title: string,
  confirm: string,
  fields: Field[],
  note = "",
  refuse = "Cancel",
): Promise<string[] | null> {
  const dialog = by<HTMLDialogElement>("ask");
  return new Promise((resolve) => {
    const inputs = fields.map(({ value, isNumber }) =>
      make(
        "input",
        isNumber ? { value, type: "number", step: "any", required: true } : { value, maxlength: "80", required: true },
      ),
    );
    const form = make(
      "form",
      { method: "dialog" },
      make("h2", {}, title),
      fields.length > 0 &&
        make("div", { class: "fields" }, ...fields.map(({ label }, i) => make("label", {}, label, inputs[i]))),
      note !== "" && make("p", { class: "note" }, note),
      make(
        "div",
        { class: "row end" },
        make("button", { type: "button", class: "quiet", onclick: () => dialog.close("") }, refuse),
        make("button", { type: "submit", class: "primary", value: "yes" }, confirm),
      ),
    );
    dialog.setAttribute("aria-label", title);
    dialog.replaceChildren(form);
    dialog.onclose = () => resolve(dialog.returnValue === "yes" ? inputs.map((input) => input.value.trim()) : null);
    dialog.returnValue = "";
    dialog.oncancel = null; // of another question
    dialog.showModal();
    inputs[0]?.select();
  });
}

/** Ask for one text until it is taken: the dialog stays open, and says why, while `take` refuses. False: gave up. */
export function askUntil(
  title: string,
  confirm: string,
  field: Field,
  take: (text: string) => Promise<void>,
): Promise<boolean> {
  const dialog = by<HTMLDialogElement>("ask");
  return new Promise((resolve) => {
    const why = make("p", { class: "note bad", role: "alert", id: "ask-why" });
    const input = make("input", { value: field.value, maxlength: "80", required: true, "aria-describedby": "ask-why" });
    const yes = make("button", { type: "submit", class: "primary" }, confirm);
    const form = make(
      "form",
      { method: "dialog" },
      make("h2", {}, title),
      make("label", {}, field.label, input),
      why,
      make(
        "div",
        { class: "row end" },
        make("button", { type: "button", class: "quiet", onclick: () => dialog.close("") }, "Cancel"),
        yes,
      ),
    );
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      yes.disabled = true;
      take(input.value.trim()).then(
        () => dialog.open && form.isConnected && dialog.close("yes"),
        (error: unknown) => {
          setText(why, sentence(error));
          yes.disabled = false;
          input.select();
        },
      );
    });
    dialog.setAttribute("aria-label", title);
    dialog.replaceChildren(form);
    dialog.onclose = () => resolve(dialog.returnValue === "yes");
    dialog.returnValue = "";
    dialog.oncancel = null; // of another question
    dialog.showModal();
    input.select();
  });
}
