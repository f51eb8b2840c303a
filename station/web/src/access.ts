// Logging in, where the station asks who you are (docs/access.md).
import { ApiError, call } from "./link/api";
import type { SessionModel } from "./link/messages";
import { by, make, show } from "./ui/dom";
import { attempt } from "./ui/toast";

const LINK = "#login="; // behind the #: browsers send it to nobody

/** Who looks at the page. Comes back only when that is known. */
export async function enter(): Promise<SessionModel> {
  let why = "";
  if (location.hash.startsWith(LINK)) {
    const code = location.hash.slice(LINK.length);
    history.replaceState(null, "", location.pathname);
    try {
      return shown(await call<SessionModel>("POST", "/login", { token: code }));
    } catch (error) {
      why = text(error);
    }
  }
  for (;;) {
    try {
      return shown(await call<SessionModel>("GET", "/session"));
    } catch (error) {
      if (error instanceof ApiError && error.status === 0) await new Promise((wake) => setTimeout(wake, 1000));
      else await login(why);
    }
  }
}

function shown(session: SessionModel): SessionModel {
  const button = by("logout");
  show(button, session.controlled);
  button.title = `${session.name}, ${session.role}`;
  button.addEventListener("click", () => attempt(() => call("POST", "/logout").then(() => location.reload())));
  return session;
}

function login(why: string): Promise<void> {
  const dialog = by("ask", HTMLDialogElement);
  return new Promise((resolve) => {
    const input = make("input", {
      type: "password",
      autocomplete: "current-password",
      maxlength: "256",
      required: true,
    });
    const note = make("p", { class: "note", role: "alert" }, why);
    const form = make(
      "form",
      {},
      make("h2", {}, "Who are you?"),
      make("label", {}, "Token", input),
      note,
      make("div", { class: "row end" }, make("button", { type: "submit", class: "primary" }, "Log in")),
    );
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      call("POST", "/login", { token: input.value.trim() }).then(
        () => {
          dialog.oncancel = null; // its other questions may be left unanswered
          dialog.close();
          resolve();
        },
        (error: unknown) => {
          note.textContent = text(error);
          input.select();
        },
      );
    });
    dialog.setAttribute("aria-label", "Log in");
    dialog.replaceChildren(form);
    dialog.oncancel = (event) => event.preventDefault();
    dialog.showModal();
  });
}

function text(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
