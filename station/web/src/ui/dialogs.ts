// Questions to the person at the page.
import { by, make, setText } from "./dom";
import { sentence } from "./text";
import { attempt } from "./toast";

/** Ask whether to do it. */
export function askConsent(title: string, confirm: string, note: string, refuse = "Cancel"): Promise<boolean> {
  const dialog = by("ask", HTMLDialogElement);
  return new Promise((resolve) => {
    const form = make(
      "form",
      { method: "dialog" },
      make("h2", {}, title),
      make("p", { class: "note" }, note),
      make(
        "div",
        { class: "row end" },
        make("button", { type: "button", class: "quiet", onclick: () => dialog.close("") }, refuse),
        make("button", { type: "submit", class: "primary", value: "yes" }, confirm),
      ),
    );
    open(dialog, title, form, () => resolve(dialog.returnValue === "yes"));
  });
}

/**
 * Ask for one text until it is taken: the dialog stays open, and says why, while `take` refuses. What `take` answered;
 * null: gave up.
 */
export function askUntil<T>(
  title: string,
  confirm: string,
  field: { label: string; value: string },
  take: (text: string) => Promise<T>,
): Promise<T | null> {
  const dialog = by("ask", HTMLDialogElement);
  return new Promise((resolve) => {
    let taken: T | null = null;
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
        (answer) => {
          taken = answer;
          if (dialog.open && form.isConnected) dialog.close("yes");
        },
        (error: unknown) => {
          setText(why, sentence(error));
          yes.disabled = false;
          input.select();
        },
      );
    });
    open(dialog, title, form, () => resolve(taken));
    input.select();
  });
}

function open(dialog: HTMLDialogElement, title: string, form: HTMLFormElement, onClose: () => void): void {
  dialog.setAttribute("aria-label", title);
  dialog.replaceChildren(form);
  dialog.onclose = onClose;
  dialog.returnValue = "";
  dialog.oncancel = null; // of another question
  dialog.showModal();
}

type ButtonMaker = (text: string, act: (() => Promise<unknown>) | null, kind?: string) => HTMLButtonElement;

/** Makes buttons that close this dialog, and then do something. */
export function closingButtons(dialog: HTMLDialogElement): ButtonMaker {
  return (text, act, kind = "") => {
    const press = () => {
      dialog.close();
      if (act) attempt(act);
    };
    return make("button", { type: "button", class: kind, onclick: press }, text);
  };
}
