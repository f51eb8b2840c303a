// Small helpers around the document.
export function by<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
}

type Child = Node | string | null | undefined | false;

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | boolean | ((event: Event) => void)> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") node.addEventListener(name.slice(2), value);
    else if (typeof value === "boolean") node.toggleAttribute(name, value);
    else node.setAttribute(name, value);
  }
  node.append(...present(...children));
  return node;
}

/** Those of the children that are there. */
export function present(...children: Child[]): (Node | string)[] {
  return children.filter((c): c is Node | string => c !== null && c !== undefined && c !== false);
}

/** A sentence whose `commands` are set as code. */
export function prose(text: string): (Node | string)[] {
  return text.split("`").map((part, i) => (i % 2 ? make("code", {}, part) : part));
}

/** Change text only when it is another one: screen readers announce every change. */
export function setText(node: HTMLElement, text: string): void {
  if (node.textContent !== text) node.textContent = text;
}

export function show(node: HTMLElement, visible: boolean): void {
  node.hidden = !visible;
}

let toastTimer = 0;

/** A sentence for a while; with what can be done about it, for longer. */
export function toast(text: string, action = "", act: () => Promise<unknown> = async () => {}): void {
  const node = by("toast");
  const run = () => {
    node.hidden = true;
    attempt(act);
  };
  node.replaceChildren(
    make("span", {}, text),
    ...(action ? [make("button", { type: "button", class: "small", onclick: run }, action)] : []),
  );
  node.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (node.hidden = true), action ? 15_000 : 6000);
}

/** Run an action of a button; its failure becomes a sentence on the screen. */
export function attempt(action: () => Promise<unknown>): void {
  action().catch((error: unknown) => toast(sentence(error)));
}

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
        make("div", { class: "fields" }, ...fields.map(({ label }, i) => make("label", {}, label, inputs[i]!))),
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

function sentence(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

export const percent = (p: number): string => `${Math.round(p * 100)} %`;

export function clock(unixS: number): string {
  return new Date(unixS * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}

/** A day, written as in the names that the station gives: 21 Nov 2026. */
export function date(unixS: number): string {
  return new Date(unixS * 1000).toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric" });
}

export function duration(s: number): string {
  const whole = Math.round(s);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/** A running time, short: 1:05. */
export function minutes(s: number): string {
  return `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
}

/** So many of something: 1 landmark, 2,000 landmarks. */
export function count(number: number, word: string): string {
  return `${number.toLocaleString("en")} ${word}${number === 1 ? "" : "s"}`;
}
