// What the dialog of the guided calibration is made of.
import { toRobot } from "../link/address";
import type {
  BoardSeenModel,
  CalibrationModel,
  CalibrationSessionModel,
  CameraResult,
  MeterModel,
} from "../link/messages";
import { make, present } from "../ui/dom";
import { count } from "../ui/text";
import { GUIDED } from "./kinds";

type Content = Node | string;

const BORROWED_MOUNTING =
  "Where the camera sits on the IMU, and when it sees, are the reference robot's: measure them next (camera and IMU).";
const NUMBERS = ["fx", "fy", "cx", "cy"];

export const link = (path: string, text: string, name = ""): HTMLAnchorElement =>
  make("a", { class: "small", href: toRobot(path), ...(name ? { download: name } : { target: "_blank" }) }, text);

export function choice(text: string, options: [string, string][]): { select: HTMLSelectElement; label: HTMLElement } {
  const select = make("select", {}, ...options.map(([value, name]) => make("option", { value }, name)));
  return { select, label: make("label", {}, text, select) };
}

export const fixed = (value: number | null | undefined, digits: number): string => value?.toFixed(digits) ?? "?";

export const row = (name: string, value: string): HTMLElement[] => [make("dt", {}, name), make("dd", {}, value)];

/** How full something is, as a bar with its name. */
function bar(text: string, share: number, note = ""): HTMLElement {
  const value = String(Math.min(1, share));
  return make(
    "li",
    { class: share >= 1 ? "full" : "" },
    make("span", {}, text),
    make("progress", { max: "1", value, "aria-label": text }),
    make("span", { class: "note" }, note),
  );
}

/** How well each quantity is known. The bar is full when its error is as small as it should be. */
function meterNote(reading: MeterModel): string {
  const digits = reading.unit ? 1 : 3;
  const unit = reading.unit ? ` ${reading.unit}` : "";
  return `${reading.value.toFixed(digits)} ± ${reading.sigma.toFixed(digits)}${unit}`;
}

/** Which views there are, and how well they tell each quantity. */
export function progressOf(seen: BoardSeenModel, kind: CalibrationSessionModel["kind"]): Content[] {
  return present(
    make(
      "ul",
      { class: "bars", "aria-label": "Views" },
      ...GUIDED[kind].bars.map(([name, text]) => bar(text, seen.poses[name] ?? 0)),
    ),
    kind === "camera" &&
      make(
        "ul",
        { class: "bars known", "aria-label": "How well it is known" },
        ...(seen.meter.length
          ? seen.meter.map((reading) => bar(reading.name, reading.wanted / reading.sigma, meterNote(reading)))
          : [make("li", { class: "note" }, "How well the numbers are known shows after six views.")]),
      ),
  );
}

/** What the robot tells now. */
export function presentOf(told: CalibrationModel): Content[] {
  const camera = told.camera;
  const focal = camera
    ? `${camera.intrinsics
        .slice(0, 2)
        .map((f) => f.toFixed(1))
        .join(", ")} px`
    : "no camera";
  return present(
    make("p", { class: "note" }, `The robot tells ${told.source}: focal length ${focal}.`),
    camera?.is_measured && !camera.is_mounting_measured && make("p", { class: "note bad" }, BORROWED_MOUNTING),
    told.fit &&
      make(
        "p",
        { class: told.fit.verdict === "does not fit" ? "note bad" : "note" },
        `Of the last drive: ${told.fit.sentence}.`,
      ),
    told.fixed && make("p", { class: "note bad" }, told.fixed),
  );
}

/** Whether to use it, and why not. */
export function verdictOf(result: { accepted: boolean; reasons: string[] }): Content[] {
  return present(
    make(
      "p",
      { class: result.accepted ? "verdict good" : "verdict bad", role: "status" },
      result.accepted ? "This calibration is good." : "This calibration is not good enough.",
    ),
    result.reasons.length > 0 && make("ul", { class: "reasons" }, ...result.reasons.map((r) => make("li", {}, r))),
  );
}

export function residualsOf(session: CalibrationSessionModel, alt: string): HTMLElement {
  const src = toRobot(`/calibration/sessions/${session.id}/residuals.png`);
  return make("a", { href: src, target: "_blank" }, make("img", { class: "residuals", src, alt }));
}

/** What the estimate came to, with what it is told by. */
export function resultOf(session: CalibrationSessionModel, result: CameraResult): Content[] {
  const values = result.intrinsics;
  const rejected = result.images_rejected;
  return present(
    ...verdictOf(result),
    values &&
      make(
        "dl",
        { class: "health numbers" },
        ...NUMBERS.flatMap((name, i) => [
          make("dt", {}, name),
          make("dd", {}, `${fixed(values[i], 2)} ± ${fixed(result.sigma[name], 2)} px`),
        ]),
        make("dt", {}, "lens"),
        make("dd", {}, `${result.model ?? ""} ${(result.distortion ?? []).map((d) => d.toFixed(4)).join(", ")}`),
        make("dt", {}, "left over"),
        make("dd", {}, `${fixed(result.rms_px, 2)} px rms, ${count(result.images_used, "picture")} used`),
      ),
    values && residualsOf(session, "What is left over of each corner, and where in the picture corners were seen"),
    rejected.length > 0 &&
      make(
        "details",
        {},
        make("summary", {}, `${count(rejected.length, "picture")} not used`),
        make("ul", { class: "note" }, ...rejected.map((one) => make("li", {}, `${one.image}: ${one.reason}`))),
      ),
  );
}
