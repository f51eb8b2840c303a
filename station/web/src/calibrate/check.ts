// What a check without a board came to.
import type { CheckResult } from "../link/messages";
import { make, present } from "../ui/dom";
import { capitalised } from "../ui/text";

/** Whether the calibration fits, and what of it does not. */
export function checkOf(result: CheckResult): (Node | string)[] {
  const [kind, verdict] = verdictOf(result);
  return present(
    make("p", { class: `verdict ${kind}`, role: "status" }, verdict),
    result.reasons.length > 0 &&
      make("ul", { class: "reasons" }, ...result.reasons.map((r) => make("li", {}, capitalised(r)))),
    make("ul", { class: "reasons" }, ...result.notes.map((note) => make("li", {}, capitalised(note)))),
  );
}

function verdictOf(result: CheckResult): [kind: string, verdict: string] {
  if (result.fits) return ["good", "The calibration fits."];
  if (result.fits === false && result.accepted)
    return ["bad", `The calibration does not fit. “Use it” repairs: ${result.repairs.join(", ")}.`];
  if (result.fits === false) return ["bad", "The calibration does not fit, and this recording does not tell how."];
  if (result.repairs.length > 0 && result.accepted) return ["bad", `“Use it” repairs: ${result.repairs.join(", ")}.`];
  return ["bad", "This recording does not tell whether all of it fits."];
}

/** Whether there is something that the robot should tell otherwise. */
export const repairs = (result: CheckResult | null): boolean => result === null || result.repairs.length > 0;
